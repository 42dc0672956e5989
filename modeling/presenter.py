"""Texts and pictures of results, made by a package above the one that the result belongs to."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Protocol

from modeling.errors import InputError


class Presenter(Protocol):
    """A module that presents results of all packages."""

    def summary(self, result: Any) -> str:
        """The result as text."""

    def plot(self, result: Any, **options: Any) -> Any:
        """The result as a picture."""

    def data(self, result: Any) -> dict[str, Any]:
        """The result as plain data."""

    def dataset(self, result: Any) -> Any:
        """The result as labelled arrays."""


_modules: list[str] = []


def register_presenter(module: str) -> None:
    """Name the module that presents results; it is imported when first asked."""
    _modules[:] = [module]


def presenter() -> Presenter:
    """The presenting module; InputError where none was registered."""
    if not _modules:
        raise InputError(what="no package presents results", where="plot", remedy="import truewrench first")
    module: Any = import_module(_modules[0])
    found: Presenter = module
    return found
