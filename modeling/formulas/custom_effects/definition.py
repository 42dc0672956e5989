"""Definition of a custom effect as plain values, its formulas as text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

from modeling.chain.chain import Stage
from modeling.formulas.custom_effects.vocabulary import FORMULA_STAGES, signal_units, tip_units
from modeling.parameter import Parameter
from modeling.space import Space

POINT_KEY = "at"
"""Key of the distance along the tip among the formulas of the tip body."""


@dataclass(frozen=True)
class PhysicalConstant:
    """A number with a unit."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value!r} {self.unit}"


@dataclass(frozen=True)
class EffectDefinition:
    """Names, units and formulas; see `CustomEffect` for their meaning.

    parameters   of the effect
    search       grid values of each nuisance parameter, by name
    inputs       columns of the recording with their unit
    constants    numbers with a unit
    steps        intermediate variables: formulas that later ones may use
    at           formula of the distance (m) along the tip at which world forces act, empty for the sensor origin
    formulas     added terms by target
    remark       the author's advice for checks on the rig
    """

    id: str
    title: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    search: tuple[tuple[str, tuple[float, ...]], ...]
    inputs: tuple[tuple[str, str], ...]
    constants: tuple[tuple[str, PhysicalConstant], ...]
    steps: tuple[tuple[str, str], ...]
    at: str
    formulas: tuple[tuple[str, str], ...]
    remark: str
    per_recording: bool

    @property
    def known(self) -> dict[str, str]:
        """Unit by name, steps excluded: parameters, inputs, constants, signals, the point on the tip."""
        found = self.fixed | dict(self.inputs)
        for space in Space:
            found |= {**tip_units(space), **signal_units(space)}
        return found

    @property
    def fixed(self) -> dict[str, str]:
        """Unit by name of the quantities that are constant during a recording."""
        return {p.name: p.unit for p in self.parameters} | {name: q.unit for name, q in self.constants}

    @property
    def nuisance_grid(self) -> tuple[dict[str, float], ...]:
        """Every combination of the values of the nuisance parameters."""
        names = [name for name, _ in self.search]
        return tuple(dict(zip(names, row, strict=True)) for row in product(*(values for _, values in self.search)))

    @property
    def key(self) -> str:
        """The key of the table with the formulas."""
        return next(key for key, stage in FORMULA_STAGES.items() if stage is self.stage)

    @property
    def equation(self) -> str:
        """The formulas as written."""
        where = [f"{name} = {text}" for name, text in self.steps] + [f"at = {self.at}"] * bool(self.at)
        added = ", ".join(self._added(name, text) for name, text in self.formulas)
        return f"{added}, where {', '.join(where)}" if where else added

    def _added(self, name: str, text: str) -> str:
        row, _, column = name.partition("_")
        return f"{row} += ({text}) {column}" if self.stage is Stage.GAIN else f"{name} += {text}"

    @property
    def advice(self) -> str:
        """Checks to make on the rig."""
        return self.remark or "it is a custom effect: check on the rig whether its cause is present"

    def to_data(self) -> dict[str, Any]:
        """The table of this definition, as plain data: numbers are finite, or None for no bound."""
        search = dict(self.search)
        parameters = {p.name: _parameter_data(p, search.get(p.name)) for p in self.parameters}
        data = {
            "id": self.id,
            "title": self.title,
            "parameters": parameters,
            "inputs": dict(self.inputs),
            "constants": {name: str(quantity) for name, quantity in self.constants},
            "let": dict(self.steps),
            self.key: ({POINT_KEY: self.at} if self.at else {}) | dict(self.formulas),
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
