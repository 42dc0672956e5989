"""Definition: all that is said of an effect of one's own, as plain values; its formulas are texts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from modeling.chain import Stage
from modeling.own.vocabulary import STAGES, signal_units, tip_units
from modeling.parameter import Parameter
from modeling.space import Space

AT = "at"
"""What the distance along the tip is called among the formulas of the tip body."""


@dataclass(frozen=True)
class Quantity:
    """A number with a unit."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value!r} {self.unit}"


@dataclass(frozen=True)
class Definition:
    """Names, units and texts; see `FormulaEffect` for what they mean.

    parameters   as the effect has them
    search       values of each parameter that is searched and not tested, by name
    inputs       columns of the recording with their unit
    constants    numbers with a unit
    steps        formulas that later ones may name
    at           a formula of the distance along the tip at which forces of the world act, empty for the sensor origin
    formulas     what is added where
    remark       what its author says to look at on the rig
    """

    id: str
    title: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    search: tuple[tuple[str, tuple[float, ...]], ...]
    inputs: tuple[tuple[str, str], ...]
    constants: tuple[tuple[str, Quantity], ...]
    steps: tuple[tuple[str, str], ...]
    at: str
    formulas: tuple[tuple[str, str], ...]
    remark: str
    per_recording: bool

    @property
    def known(self) -> dict[str, str]:
        """The unit of each name that is no step: parameters, inputs, constants, signals, the point on the tip."""
        found = self.fixed | dict(self.inputs)
        for space in Space:
            found |= {**tip_units(space), **signal_units(space)}
        return found

    @property
    def fixed(self) -> dict[str, str]:
        """The unit of each name that does not change during a recording."""
        return {p.name: p.unit for p in self.parameters} | {name: q.unit for name, q in self.constants}

    @property
    def key(self) -> str:
        """The table that the formulas stand in."""
        return next(key for key, stage in STAGES.items() if stage is self.stage)

    @property
    def equation(self) -> str:
        """The formulas as they were written."""
        where = [f"{name} = {text}" for name, text in self.steps] + [f"at = {self.at}"] * bool(self.at)
        added = ", ".join(self._added(name, text) for name, text in self.formulas)
        return f"{added}, where {', '.join(where)}" if where else added

    def _added(self, name: str, text: str) -> str:
        row, _, column = name.partition("_")
        return f"{row} += ({text}) {column}" if self.stage is Stage.GAIN else f"{name} += {text}"

    @property
    def advice(self) -> str:
        """What to look at on the rig."""
        return self.remark or "it is an effect of your own: go and see whether it is there"

    def to_data(self) -> dict[str, Any]:
        """The table that this was read from, as plain data: numbers are finite, or None for an open end."""
        search = dict(self.search)
        parameters = {p.name: _parameter_data(p, search.get(p.name)) for p in self.parameters}
        data = {
            "id": self.id,
            "title": self.title,
            "parameters": parameters,
            "inputs": dict(self.inputs),
            "constants": {name: str(quantity) for name, quantity in self.constants},
            "let": dict(self.steps),
            self.key: ({AT: self.at} if self.at else {}) | dict(self.formulas),
            "advice": self.remark,
            "per_recording": self.per_recording,
        }
        return {name: value for name, value in data.items() if value not in ({}, "", False)}


def _parameter_data(parameter: Parameter, search: tuple[float, ...] | None) -> dict[str, Any]:
    data: dict[str, Any] = {"unit": parameter.unit}
    if parameter.bounds != (-math.inf, math.inf):
        data["bounds"] = [b if math.isfinite(b) else None for b in parameter.bounds]
    if parameter.nominal and search is None:
        data["nominal"] = parameter.nominal
    return data if search is None else data | {"search": list(search)}
