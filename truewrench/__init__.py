"""Force/torque sensor models: identification, residual diagnosis and experiment design (public names).

The names and their modules stand in `__init__.pyi`, which a type checker reads too; each is imported at its first use,
so that importing truewrench stays fast.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


@cache
def _modules() -> dict[str, str]:
    """The module of every public name, from the imports of the stub."""
    import ast

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


@cache
def _register() -> None:
    """Say who presents results: `fit.summary()` asks the module named here."""
    import_module("modeling.presenter").register_presenter("truewrench.presentation")


def __getattr__(name: str) -> Any:
    """The public name, from its module."""
    if name == "__version__":
        return import_module("importlib.metadata").version("truewrench")
    if name == "__all__":
        return sorted(_modules())
    if name in _modules():
        _register()
        if _modules()[name] == __name__:
            return import_module(f"{__name__}.{name}")
        return getattr(__import__(_modules()[name], fromlist=[name]), name)
    raise AttributeError(f"module 'truewrench' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Everything that `__getattr__` gives, for completion in a notebook."""
    own = [name for name in globals() if name.startswith("__")]
    return sorted([*own, *_modules(), "__version__"])
