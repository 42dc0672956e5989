"""Search: an effect tried at every point of its grid, the best point, and what the search costs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.columns import FEW, sensitivity_of
from diagnosis.price import frequencies_tried, independent_trials
from diagnosis.projection import Projected, Trial, Whitened
from diagnosis.rows import Choice, Rows
from diagnosis.secants import Point, effect_columns
from estimation.layout import layout
from estimation.response import repeats_with_motion
from modeling.effect import Effect, Values
from modeling.model import WrenchModel
from modeling.prediction import compiled
from modeling.space import Space

Array = NDArray[np.float64]

MOST_MOVES = 8
"""Times that a window's edges may move by a sample: the grid of windows is finer than that where one was noticed."""


def points_of(model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> list[Point]:
    """The points of an effect's grid under the parameters' full names."""
    own, full = effect.parameters(model.space), effect.qualified(model.space)
    names = {p.name: q.name for p, q in zip(own, full, strict=True)}
    amplitudes = tuple(p for p in full if not p.nuisance)
    return [Point({names[k]: v for k, v in values.items()}, amplitudes) for values in grid]


def reached_rows(
    background: Background, model: WrenchModel, point: Point | None = None, *, judged: bool = True
) -> Choice:
    """The rows of each recording that a model's last effect reaches, or (`judged`) those in which it is judged.

    They are those of the sensitivities alone, where a `point` of the search domain is given that has no secants.

    What does not repeat with the motion is judged between the motion's lines only: on them it would be taken for
    anything periodic that the model lacks, because a push or a drift has some of every shape.
    """
    fit, effect = background.fit, model.effects[-1]
    alone = compiled(model.base + effect)
    inputs = {*alone.load.inputs, *alone.zero.inputs}
    lasting = all(repeats_with_motion(inputs, recording) for recording in fit.recordings)
    unknowns = layout(model, fit.recordings)
    choice = []
    for own, recording, noise in zip(unknowns.models, fit.recordings, fit.noise, strict=True):
        rest = noise.whitener.rows > noise.whitener.steady_rows
        if effect.id not in [e.id for e in own.effects]:
            choice.append(Rows.NONE)
        elif not rest or repeats_with_motion(moving_signals(own, point), recording):
            choice.append(Rows.STEADY)
        elif judged and not lasting and not repeats_with_motion(inputs, recording):
            choice.append(Rows.REST)
        else:
            choice.append(Rows.WHOLE)
    return tuple(choice)


def moving_signals(model: WrenchModel, point: Point | None) -> set[str]:
    """Signals on which the sensitivities of a model's last effect depend; all of the model's where they are secants."""
    prediction = compiled(model)
    parts = (prediction.load, prediction.zero)
    everything = {name for part in parts for name in part.inputs}
    if point is None or point.named or prediction.play or prediction.level or prediction.bend:
        return everything
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in point.amplitudes)
    if set(which) & set(prediction.memory_parameters):
        return everything
    return {
        name for part in parts if set(which) & set(part.active) for name in sensitivity_of(model, part, which).signals
    }


def projected_at(
    background: Background, model: WrenchModel, effect: Effect, grid: Sequence[Values], *, refined: bool = False
) -> Projected:
    """An effect, the last of the model, at points of its search domain, in the rows where it is judged.

    A search that is `refined` passes its points once, whatever the amplitude's sign; the columns are not kept.
    """
    points = points_of(model, effect, grid)
    combination = effect.combination(grid)
    blocks = points if combination.blocks == tuple(grid) else points_of(model, effect, combination.blocks)
    choice = reached_rows(background, model, blocks[0])

    def make() -> Whitened:
        return Whitened(effect_columns(background, model, blocks, choice), choice)

    key = None if refined else _dependence(background, model, blocks, choice)
    low = -np.inf if refined else points[0].lowest()
    return Projected(background, background.workspace.whitened(key, make), combination, low)


def _dependence(background: Background, model: WrenchModel, blocks: Sequence[Point], choice: Choice) -> Hashable | None:
    """What many whitened columns depend on; None where that changes from fit to fit, or where they are few."""
    fit, prediction = background.fit, compiled(model)
    simple = prediction.instantaneous and len(fit.recordings) == 1 and not blocks[0].named
    if len(blocks) <= FEW or not simple:
        return None
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in blocks[0].amplitudes)
    parts = []
    for emitted in (prediction.load, prediction.zero):
        if set(which) & set(emitted.active):
            found = sensitivity_of(model, emitted, which)
            parts.append((found.expression, tuple((n, fit.values[n]) for n in found.parameters if n in fit.values)))
    values = tuple(tuple(sorted(point.values.items())) for point in blocks)
    return (fit.noise, fit.recordings, choice, tuple(parts), values)


@dataclass(frozen=True, eq=False)
class Search:
    """An effect tried at every point of its search domain.

    place        number of the best point, with its trial `best`
    std          standard deviations (g, a) of the amounts at each point
    doubt        variance of the logarithm of the noise's power where the best score comes from
    independent  number of independent trials that the search amounts to
    reached      whether anything of the effect is in any row
    samples      of the longest recording
    """

    effect: Effect
    space: Space
    grid: tuple[Point, ...]
    place: int
    best: Trial
    std: Array
    doubt: float
    independent: float
    reached: bool
    samples: int

    @classmethod
    def over(cls, background: Background, model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> Search:
        """The search over a grid that is not empty."""
        projected = projected_at(background, model, effect, grid)
        place = _best(projected)
        best = projected.trial(place)
        return cls(
            effect=effect,
            space=model.space,
            grid=tuple(points_of(model, effect, grid)),
            place=place,
            best=best,
            std=projected.std,
            doubt=projected.doubt(place),
            independent=independent_trials(projected.noise_scores(), best.rank) if len(grid) > 1 and best.rank else 1.0,
            reached=bool(projected.gram.any()),
            samples=max(r.samples for r in background.fit.recordings),
        )

    @property
    def point(self) -> Point:
        """Where the best trial is."""
        return self.grid[self.place]

    @property
    def start(self) -> Values:
        """Parameter values from which to refit."""
        return self.point.start(self.best.amounts)

    @property
    def cost(self) -> float:
        """Number of independent trials to be paid for: of the grid, or of all frequencies that a tone may have."""
        nuisances = [p for p in self.effect.parameters(self.space) if p.nuisance]
        if any(p.unit == "Hz" for p in nuisances):
            return max(self.independent, frequencies_tried(self.best.score, self.samples))
        return self.independent

    @property
    def why_not(self) -> str:
        """Why no amount of the effect can be estimated."""
        if not self.reached:
            return "nothing in this motion would show it"
        return "other parameters of the model explain all that it would do in this motion"

    def amounts(self) -> Mapping[str, tuple[float, float]]:
        """Each amplitude's estimate from its nominal value (an infinite one: the value itself), with its std.

        An infinite one is counted by its inverse, as what it does is: an amount a of the value v is v / a.
        """
        found = {}
        for p, amount, std in zip(self.point.amplitudes, self.best.amounts, self.best.std, strict=True):
            unit = self.point.unit_of(p)
            if isfinite(p.nominal):
                found[p.name] = (float(amount * unit), float(std * abs(unit)))
            else:
                found[p.name] = (unit, float(abs(unit) * std))
        return found

    def detectable(self, separation: float) -> Mapping[str, float]:
        """The amount of each amplitude, from nominal, with that whitened separation from none.

        One with an infinite nominal value does the less the larger it is: the value, within the grid, at whose own
        point what it does is nearest to that separation.
        """
        needed = np.sqrt(separation) * self.std
        found = {}
        for i, p in enumerate(self.point.amplitudes):
            if isfinite(p.nominal):
                found[p.name] = float(needed[self.place, i] * abs(self.point.unit_of(p)))
                continue
            sizes = np.array([point.unit_of(p) for point in self.grid])
            shown = np.maximum(np.where(needed[:, i] > 0, needed[:, i], np.inf), 1e-300)
            near = int(np.argmin(np.abs(np.log(shown))))
            found[p.name] = float(np.clip(sizes[near] / shown[near], sizes.min(), sizes.max()))
        return found


def _best(projected: Projected) -> int:
    """The point with the largest score; where none is above zero, one that shows the effect."""
    return int(np.lexsort((-np.arange(len(projected.found[0])), projected.directions[1], projected.found[0]))[-1])


def sharpened(background: Background, effect: Effect, start: Values) -> Values:
    """The start of a refit with its times (s) moved, by quarters of a sample, to where the effect explains most.

    An edge shorter than a sample gives its time no derivative until it falls on a sample, and in slow noise half a
    sample beside it is a shock: the exact refit would stop where the screening's grid of windows points.
    """
    fit = background.fit
    model = fit.model + effect
    own = model.effects[-1].qualified(model.space)
    times = [p.name for p in own if p.nuisance and p.unit == "s"]
    steps = [r.dt for r in fit.recordings if r.dt is not None and r.repeats > 1]
    if not times or not steps:
        return start
    short = {p.name: p.name.removeprefix(f"{effect.id}.") for p in own}
    nuisances = {p.name: start[p.name] for p in own if p.nuisance}
    shifts = list(product(min(steps) * np.linspace(-1.0, 1.0, 9), repeat=len(times)))
    for _ in range(MOST_MOVES):
        moved = [nuisances | {t: nuisances[t] + by for t, by in zip(times, shift, strict=True)} for shift in shifts]
        grid = [{short[name]: value for name, value in values.items()} for values in moved]
        scores = projected_at(background, model, model.effects[-1], grid, refined=True).found[0]
        best = moved[int(scores.argmax())]
        if scores.max() <= scores[len(shifts) // 2]:
            break
        nuisances = best
    return start | nuisances
