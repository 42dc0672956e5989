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


def _function(member: object) -> FunctionType | None:
    """The function of a method, class method or static method; None for anything else."""
    found = getattr(member, "__func__", member)
    return found if isinstance(found, FunctionType) else None


def _names(function: FunctionType) -> tuple[list[str], set[str]]:
    """Positional parameters in order, and all that a keyword may name."""
    parameters = inspect.signature(function).parameters.values()
    positional = [p.name for p in parameters if p.kind in POSITIONAL]
    return positional, {p.name for p in parameters if p.kind is not inspect.Parameter.POSITIONAL_ONLY}


def _other_names(owner: type) -> Iterator[str]:
    """Methods that lack a parameter of the method that they override, or have it at another place."""
    for name, member in vars(owner).items():
        own = _function(member)
        if own is None or name.startswith("__"):
            continue
        for base in owner.__mro__[1:]:
            overridden = _function(vars(base).get(name))
            if overridden is None or base.__module__.split(".")[0] not in PACKAGES:
                continue
            (positional, known), (expected, all_expected) = _names(own), _names(overridden)
            if positional[: len(expected)] != expected or not all_expected <= known:
                yield f"{owner.__module__}.{owner.__qualname__}.{name}"


def test_overriding_methods_name_their_parameters_alike() -> None:
    classes = list(_own_classes())
    assert len(classes) > 300
    assert [name for owner in classes for name in _other_names(owner)] == []


def test_other_names_are_found() -> None:
    class Base:
        def method(self, first: int, second: int) -> int:
            return first + second

        @classmethod
        def made(cls, first: int, *, keyword: int) -> int:
            return first + keyword

    class Alike(Base):
        def method(self, first: int, second: int, third: int = 0) -> int:
            return first + second + third

    class Renamed(Base):
        def method(self, first: int, other: int) -> int:
            return first + other

    class WithoutKeyword(Base):
        @classmethod
        def made(cls, first: int) -> int:  # type: ignore[override]
            return first

    for each in (Base, Alike, Renamed, WithoutKeyword):
        each.__module__ = "modeling.example"
    assert list(_other_names(Alike)) == []
    assert [name.split(".")[-1] for name in _other_names(Renamed)] == ["method"]
    assert [name.split(".")[-1] for name in _other_names(WithoutKeyword)] == ["made"]
