"""Secants: what an effect of a certain size does, where its derivative at the nominal value says nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.columns import FEW, amplitude_columns
from diagnosis.rows import Choice, Rows
from estimation.layout import Layout, layout
from estimation.response import Response, respond
from estimation.whitening import Whitener
from modeling.chain import Stage
from modeling.effect import Values
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.parameter import Parameter

Array = NDArray[np.float64]

SCREENED = 1e-8
"""Size of the last correction of a tool's bend in a secant, against its own.

Near a resonance ten times as much is missing then. A score of a thousand std is off by a ten-thousandth of one.
"""


@dataclass(frozen=True, eq=False)
class Point:
    """One point of a grid that an effect is searched over: the values (SI) of its parameters by their full names.

    An amplitude that the point names is screened by its secant, prediction(value) - prediction(nominal), so that an
    amount of 1 means the value; any other by the derivative at its nominal value, an amount in its own unit.
    """

    values: Values
    amplitudes: tuple[Parameter, ...]

    @property
    def named(self) -> tuple[Parameter, ...]:
        """The amplitudes screened by secants."""
        return tuple(p for p in self.amplitudes if p.name in self.values)

    @property
    def nuisances(self) -> Values:
        """The values that are not of amplitudes."""
        amplitudes = {p.name for p in self.amplitudes}
        return {name: value for name, value in self.values.items() if name not in amplitudes}

    def unit_of(self, parameter: Parameter) -> float:
        """How far from its nominal value an amount of 1 takes an amplitude; of an infinite one, as far as its value."""
        if parameter.name not in self.values:
            return 1.0
        value = self.values[parameter.name]
        return value - parameter.nominal if isfinite(parameter.nominal) else value

    def start(self, amounts: Array) -> Values:
        """Parameter values from which to refit, given the amounts (a,) of the amplitudes.

        One whose nominal value is infinite starts at the point's own value.
        """
        found = dict(self.values)
        for p, amount in zip(self.amplitudes, amounts, strict=True):
            if isfinite(p.nominal):
                found[p.name] = float(np.clip(p.nominal + amount * self.unit_of(p), *p.bounds))
        return found

    def lowest(self) -> float:
        """The lowest amount of a single amplitude that its bounds allow; no bound where there are several."""
        if len(self.amplitudes) != 1:
            return -np.inf
        (p,) = self.amplitudes
        if not isfinite(p.nominal):
            return 0.0
        return float(min((bound - p.nominal) / self.unit_of(p) for bound in p.bounds))


def effect_columns(background: Background, model: WrenchModel, grid: Sequence[Point], choice: Choice) -> Array:
    """Whitened columns (r, g, a) of the last effect's a amplitudes at g points: secants where named, or tangents.

    They are given in the rows of each recording that `choice` says.
    """
    amplitudes = grid[0].amplitudes
    named = {p.name for p in grid[0].named}
    tangents = [i for i, p in enumerate(amplitudes) if p.name not in named]
    if tangents:
        plain = model if len(grid) <= FEW else unbent(model)
        values, names = [p.nuisances for p in grid], [amplitudes[i].name for i in tangents]
        found = amplitude_columns(background, plain, values, names, choice)
        if not named:
            return found
    ranges = [rows.within(n.whitener) for rows, n in zip(choice, background.fit.noise, strict=True)]
    columns = np.zeros((sum(last - first for first, last in ranges), len(grid), len(amplitudes)))
    if tangents:
        columns[:, :, tangents] = found
    unknowns, start = layout(model, background.fit.recordings), 0
    for number, (noise, (first, last)) in enumerate(zip(background.fit.noise, ranges, strict=True)):
        own = slice(start, start + last - first)
        start = own.stop
        for g, i, difference in differences(background, unknowns, number, grid) if last > first else ():
            columns[own, g, i] = difference.whitened(noise.whitener, choice[number])
    return columns


def unbent(model: WrenchModel) -> WrenchModel:
    """The model with a stiff tool: what other effects do is nearly the same, and found a hundred times as fast.

    Only for few points are the derivatives of a bending tool worth their time; a longer search sees it stiff.
    """
    return replace(model, effects=tuple(e for e in model.effects if e.stage is not Stage.BEND))


@dataclass(frozen=True, eq=False)
class Difference:
    """What changes in a predicted reading: (n, p) over a repeat (`periodic`) and over the whole record, to be added."""

    periodic: Array
    whole: Array | None
    repeats: int

    @classmethod
    def of(cls, first: Response, second: Response) -> Difference:
        """The first response less the second, of one recording."""
        parts = [sign * r.whole[0] for sign, r in ((1, first), (-1, second)) if r.whole is not None]
        whole = np.asarray(sum(parts)) if parts else None
        return cls(first.periodic[0] - second.periodic[0], whole, first.repeats)

    @property
    def series(self) -> Array:
        """Over the whole record, (n, p)."""
        tiled = np.tile(self.periodic, (self.repeats, 1))
        return tiled if self.whole is None else tiled + self.whole

    def whitened(self, whitener: Whitener, rows: Rows) -> Array:
        """As rows (r,)."""
        found = rows.whitened(whitener, self.periodic, periodic=True)
        return found if self.whole is None else found + rows.whitened(whitener, self.whole, periodic=False)


def differences(
    background: Background, unknowns: Layout, number: int, grid: Sequence[Point]
) -> Iterator[tuple[int, int, Difference]]:
    """Per grid point and amplitude named there, what the last effect with that amplitude alone adds to a recording.

    Yields the point's number, the amplitude's, and the difference; nothing for a recording without the effect.
    """
    fit, model = background.fit, unknowns.models[number]
    if not set(grid[0].values) & {p.name for p in model.parameters}:
        return
    recording = fit.recordings[number]
    before = respond(fit.layout.models[number], recording, fit.theta[fit.layout.index[number]], derivative=False)
    names = [unknowns.parameters[i].name for i in unknowns.index[number]]
    for g, point in enumerate(grid):
        for i, amplitude in enumerate(point.amplitudes):
            if amplitude.name not in point.values:
                continue
            known = {**fit.values, **point.nuisances, amplitude.name: point.values[amplitude.name]}
            theta = np.array([known.get(n, p.nominal) for n, p in zip(names, model.parameters, strict=True)])
            try:
                after = respond(model, recording, theta, derivative=False, tolerance=SCREENED)
            except InputError:
                continue  # a spring too soft to carry the tool: no such thing is there
            yield g, i, Difference.of(after, before)
