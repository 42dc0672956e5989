"""Lazy import of SymPy, loaded when one of its names is first used: `from modeling import symbolic as sp`.

The description of a model (catalogue, parameters with units, stages) is in the same modules as its derivation; only
the derivation needs SymPy, which takes most of a second to load.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # module attributes that the import system asks for: not SymPy's
        raise AttributeError(name)
    import sympy

    value = globals()[name] = getattr(sympy, name)
    return value
