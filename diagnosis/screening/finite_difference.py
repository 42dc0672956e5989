"""Score columns by finite difference where the derivative at the nominal value vanishes or does not exist."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import NullModel
from diagnosis.screening.row_selection import RowChoice, RowSet
from diagnosis.screening.whitened_sensitivity import MAX_EXACT_POINTS, whitened_sensitivities
from estimation.model_response import ModelResponse, model_response
from estimation.noise.whitening import Whitener
from estimation.parameter_layout import ParameterLayout, parameter_layout
from modeling.chain.chain import Stage
from modeling.chain.effect import NuisanceValues
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.parameter import Parameter

Array = NDArray[np.float64]

SCREENED = 1e-8
"""Relative tolerance of the deflection solution in a finite difference.

Near a resonance the error is ten times as large: 1e-4 std in a score of a thousand std.
"""


@dataclass(frozen=True, eq=False)
class GridPoint:
    """One point of an effect's search grid: values (SI) of its parameters by their full names.

    The score column of an amplitude that the point names is the finite difference prediction(value) -
    prediction(nominal), so that an amount of 1 means the value; that of any other is the derivative at its nominal
    value, with amounts in its own unit.
    """

    values: NuisanceValues
    amplitudes: tuple[Parameter, ...]

    @property
    def named(self) -> tuple[Parameter, ...]:
        """The amplitudes with score columns by finite difference."""
        return tuple(p for p in self.amplitudes if p.name in self.values)

    @property
    def nuisances(self) -> NuisanceValues:
        """Values of the nonlinear parameters."""
        amplitudes = {p.name for p in self.amplitudes}
        return {name: value for name, value in self.values.items() if name not in amplitudes}

    def unit_of(self, parameter: Parameter) -> float:
        """Change of an amplitude per unit amount; where its nominal value is infinite, the point's value."""
        if parameter.name not in self.values:
            return 1.0
        value = self.values[parameter.name]
        return value - parameter.nominal if isfinite(parameter.nominal) else value

    def start(self, amounts: Array) -> NuisanceValues:
        """Initial values of a refit, given the estimated amounts (a,) of the amplitudes.

        An amplitude with an infinite nominal value starts at the point's value.
        """
        found = dict(self.values)
        for p, amount in zip(self.amplitudes, amounts, strict=True):
            if isfinite(p.nominal):
                found[p.name] = float(np.clip(p.nominal + amount * self.unit_of(p), *p.bounds))
        return found

    def lowest(self) -> float:
        """Lower bound of a single amplitude's amount; -inf where there are several amplitudes."""
        if len(self.amplitudes) != 1:
            return -np.inf
        (p,) = self.amplitudes
        if not isfinite(p.nominal):
            return 0.0
        return float(min((bound - p.nominal) / self.unit_of(p) for bound in p.bounds))


def score_columns(null_model: NullModel, model: WrenchModel, grid: Sequence[GridPoint], choice: RowChoice) -> Array:
    """Score columns (r, g, a) of the last effect's a amplitudes at g points, in the chosen rows of each recording.

    Finite differences for amplitudes that the points name, derivatives for the others.
    """
    amplitudes = grid[0].amplitudes
    named = {p.name for p in grid[0].named}
    differentiated = [i for i, p in enumerate(amplitudes) if p.name not in named]
    found: Array | None = None
    if differentiated:
        plain = model if len(grid) <= MAX_EXACT_POINTS else without_deflection(model)
        values, names = [p.nuisances for p in grid], [amplitudes[i].name for i in differentiated]
        found = whitened_sensitivities(null_model, plain, values, names, choice)
        if not named:
            return found
    ranges = [rows.within(n.whitener) for rows, n in zip(choice, null_model.fit.noise, strict=True)]
    columns = np.zeros((sum(last - first for first, last in ranges), len(grid), len(amplitudes)))
    if found is not None:
        columns[:, :, differentiated] = found
    unknowns, start = parameter_layout(model, null_model.fit.recordings), 0
    for number, (noise, (first, last)) in enumerate(zip(null_model.fit.noise, ranges, strict=True)):
        own = slice(start, start + last - first)
        start = own.stop
        for g, i, difference in response_differences(null_model, unknowns, number, grid) if last > first else ():
            columns[own, g, i] = difference.whitened(noise.whitener, choice[number])
    return columns


def without_deflection(model: WrenchModel) -> WrenchModel:
    """The model without deflection, for searches over many points: nearly the same sensitivities, 100 times as fast."""
    return replace(model, effects=tuple(e for e in model.effects if e.stage is not Stage.DEFLECTION))


@dataclass(frozen=True, eq=False)
class ResponseDifference:
    """Difference of two predicted readings (n, p): `periodic` part over one repeat plus one over the `whole` record."""

    periodic: Array
    whole: Array | None

    @classmethod
    def of(cls, first: ModelResponse, second: ModelResponse) -> ResponseDifference:
        """First response minus second, of one recording."""
        parts = [sign * r.whole[0] for sign, r in ((1, first), (-1, second)) if r.whole is not None]
        whole = np.asarray(sum(parts)) if parts else None
        return cls(first.periodic[0] - second.periodic[0], whole)

    def whitened(self, whitener: Whitener, rows: RowSet) -> Array:
        """The difference whitened, in some rows (r,)."""
        found = rows.whitened(whitener, self.periodic, periodic=True)
        return found if self.whole is None else found + rows.whitened(whitener, self.whole, periodic=False)


def response_differences(
    null_model: NullModel, unknowns: ParameterLayout, number: int, grid: Sequence[GridPoint]
) -> Iterator[tuple[int, int, ResponseDifference]]:
    """Change of a recording's prediction by the last effect, per grid point and for each amplitude named there alone.

    Yields point index, amplitude index and difference; nothing for a recording without the effect.
    """
    fit, model = null_model.fit, unknowns.models[number]
    if not set(grid[0].values) & {p.name for p in model.parameters}:
        return
    recording = fit.recordings[number]
    before = model_response(fit.layout.models[number], recording, fit.theta[fit.layout.index[number]], derivative=False)
    for g, point in enumerate(grid):
        for i, amplitude in enumerate(point.amplitudes):
            if amplitude.name not in point.values:
                continue
            known = {**fit.values, **point.nuisances, amplitude.name: point.values[amplitude.name]}
            theta = unknowns.values_of(number, known)
            try:
                after = model_response(model, recording, theta, derivative=False, tolerance=SCREENED)
            except InputError:
                continue  # a spring too soft to carry the tool: no equilibrium
            yield g, i, ResponseDifference.of(after, before)
