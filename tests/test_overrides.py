"""Overriding methods name their parameters as the methods they override: a call by keyword works for every class."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from pkgutil import walk_packages
from types import FunctionType

PACKAGES = ("modeling", "design", "estimation", "diagnosis", "truewrench")
POSITIONAL = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.POSITIONAL_ONLY)


def _own_classes() -> Iterator[type]:
    for name in PACKAGES:
        package = import_module(name)
        for found in walk_packages(package.__path__, f"{name}."):
            module = import_module(found.name)
            yield from (c for c in vars(module).values() if isinstance(c, type) and c.__module__ == found.name)


def _positional(function: FunctionType) -> list[str]:
    parameters = inspect.signature(function).parameters.values()
    return [p.name.lstrip("_") for p in parameters if p.kind in POSITIONAL]


def _other_names(owner: type) -> Iterator[str]:
    """Methods whose positional parameters have other names than those of the method that they override."""
    for name, own in vars(owner).items():
        if not isinstance(own, FunctionType) or name.startswith("__"):
            continue
        for base in owner.__mro__[1:]:
            overridden = vars(base).get(name)
            if base.__module__.split(".")[0] in PACKAGES and isinstance(overridden, FunctionType):
                expected = _positional(overridden)
                if _positional(own)[: len(expected)] != expected:
                    yield f"{owner.__module__}.{owner.__qualname__}.{name}"


def test_overriding_methods_name_their_parameters_alike() -> None:
    classes = list(_own_classes())
    assert len(classes) > 300
    assert [name for owner in classes for name in _other_names(owner)] == []


def test_other_names_are_found() -> None:
    class Base:
        def method(self, first: int, second: int) -> int:
            return first + second

    class Alike(Base):
        def method(self, first: int, second: int, third: int = 0) -> int:
            return first + second + third

    class Renamed(Base):
        def method(self, first: int, other: int) -> int:
            return first + other

    for each in (Base, Alike, Renamed):
        each.__module__ = "modeling.example"
    assert list(_other_names(Alike)) == []
    assert [name.split(".")[-1] for name in _other_names(Renamed)] == ["method"]
