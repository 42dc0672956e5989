"""Outline: what a model consists of, as plain data: enough to know what it needs before it is evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

from modeling import symbolic as sp
from modeling.column import Column


@dataclass(frozen=True, kw_only=True)
class Part:
    """A column: the signals that it takes, the names of its parameters, and which of these it depends on."""

    inputs: tuple[str, ...]
    names: tuple[str, ...]
    active: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Outline:
    """The parts by name (see `WrenchModel.columns`), and whether there is a transfer function."""

    parts: Mapping[str, Part]
    remembers: bool

    @classmethod
    def of(cls, columns: Mapping[str, Column], memory: sp.Expr) -> Self:
        """Of what was derived."""
        parts = {n: Part(inputs=c.inputs, names=c.names, active=c.active) for n, c in columns.items()}
        return cls(parts=parts, remembers=bool(memory != 1))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """What `to_data` gave; KeyError or TypeError where it did not."""
        parts = {name: _part(**part) for name, part in data["parts"].items()}
        return cls(parts=parts, remembers=bool(data["remembers"]))

    def to_data(self) -> dict[str, Any]:
        """It as plain data."""
        return asdict(self)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all signals that the parts need, and the clock where the past counts."""
        names = {name for part in self.parts.values() for name in part.inputs}
        return tuple(sorted(names | ({"time"} if self.remembers else set())))


def _part(*, inputs: list[str], names: list[str], active: list[int]) -> Part:
    return Part(inputs=tuple(inputs), names=tuple(names), active=tuple(active))
