"""SymPy under another name, loaded when a name of it is first used: `from modeling import symbolic as sp`.

What describes a model (the catalogue, parameters with units, stages) stands in the same modules as what derives it;
only the second needs SymPy, which takes most of a second to load.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # asked of every module by the machinery of imports, and SymPy's is none of its business
        raise AttributeError(name)
    import sympy

    value = globals()[name] = getattr(sympy, name)
    return value
