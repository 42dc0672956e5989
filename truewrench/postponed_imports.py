"""Modules that a command imports without using them are loaded with their first use.

SciPy's array API takes over every public name of NumPy, and NumPy imports the submodule behind each: its Fortran
wrapper generator and its test tools are a quarter of the time in which SciPy is imported. SciPy's reader of docstrings
needs `pydoc` for classes alone.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

POSTPONED = frozenset({"numpy.f2py", "numpy.testing", "pydoc"})
"""Modules that no command needs, and that are imported nevertheless."""


class PostponedFinder:
    """Finds the modules of POSTPONED where Python does, and lets them be executed when an attribute is asked for."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """The module's spec, with a lazy loader; None for all other modules."""
        if name not in POSTPONED:
            return None
        from importlib.util import LazyLoader  # slow to import: commands that need no SciPy do without

        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def postpone_imports() -> None:
    """Postpone the modules of POSTPONED in this process, and in those forked from it; once is enough."""
    if not any(isinstance(finder, PostponedFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, PostponedFinder())
