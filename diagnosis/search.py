"""Search: an effect tried at every point of its grid, the best point, and what the search costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import DRAWS, Background
from diagnosis.columns import where_judged
from diagnosis.price import frequencies_tried, independent_trials
from diagnosis.projection import Projected, Trial
from diagnosis.secants import Point, effect_columns
from estimation.response import repeats_with_motion
from modeling.effect import Effect, Values
from modeling.model import WrenchModel
from modeling.prediction import compiled

Array = NDArray[np.float64]

CHUNK = 64
"""Points looked at together: grids have hundreds, and their columns would not fit into memory at once."""
MOST_MOVES = 8
"""Times that a window's edges may move by a sample: the grid of windows is finer than that where one was noticed."""


def points_of(model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> list[Point]:
    """The points of an effect's grid under the parameters' full names."""
    own, full = effect.parameters(model.space), effect.qualified(model.space)
    names = {p.name: q.name for p, q in zip(own, full, strict=True)}
    amplitudes = tuple(p for p in full if not p.nuisance)
    return [Point({names[k]: v for k, v in values.items()}, amplitudes) for values in grid]


def judged_columns(background: Background, model: WrenchModel, grid: Sequence[Point]) -> Array:
    """Columns (rows, g, a) of a model's last effect, in the rows where it is judged: see `where_judged`."""
    columns = effect_columns(background, model, grid)
    alone = compiled(model.base + model.effects[-1])
    inputs = {*alone.load.inputs, *alone.zero.inputs}
    lasting = all(repeats_with_motion(inputs, recording) for recording in background.fit.recordings)
    return columns if lasting else where_judged(background.fit, columns)


@dataclass(frozen=True, eq=False)
class Search:
    """An effect, the last of `model`, tried at every point of a grid; `trials` in the grid's order.

    independent  number of independent trials that the search amounts to
    """

    background: Background
    model: WrenchModel
    grid: tuple[Point, ...]
    trials: tuple[Trial, ...]
    independent: float
    reached: bool

    @classmethod
    def over(cls, background: Background, model: WrenchModel, grid: Sequence[Point]) -> Search:
        """The search over a grid that is not empty."""
        trials: list[Trial] = []
        noise_scores, reached = np.zeros(DRAWS), False
        for chunk in (grid[i : i + CHUNK] for i in range(0, len(grid), CHUNK)):
            projected = Projected(background, judged_columns(background, model, chunk), chunk[0].lowest())
            trials += projected.trials
            reached = reached or bool(projected.columns.any())
            if len(grid) > 1:
                noise_scores = np.maximum(noise_scores, projected.noise_scores())
        rank = max(trials, key=_worth).rank
        independent = independent_trials(noise_scores, rank) if len(grid) > 1 and rank else 1.0
        return cls(background, model, tuple(grid), tuple(trials), independent, reached)

    @cached_property
    def place(self) -> int:
        """The number of the best trial."""
        return max(range(len(self.trials)), key=lambda i: _worth(self.trials[i]))

    @property
    def best(self) -> Trial:
        """The trial with the largest score."""
        return self.trials[self.place]

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
        nuisances = [p for p in self.model.effects[-1].parameters(self.model.space) if p.nuisance]
        if any(p.unit == "Hz" for p in nuisances):
            samples = max(r.samples for r in self.background.fit.recordings)
            return max(self.independent, frequencies_tried(self.best.score, samples))
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
        needed = np.sqrt(separation) * np.array([t.std for t in self.trials])
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


def _worth(trial: Trial) -> tuple[float, int]:
    """The score; where none is above zero, a point that shows the effect goes before one that does not."""
    return trial.score, trial.rank


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
    amplitudes = tuple(p for p in own if not p.nuisance)
    nuisances = {p.name: start[p.name] for p in own if p.nuisance}
    shifts = list(product(min(steps) * np.linspace(-1.0, 1.0, 9), repeat=len(times)))
    for _ in range(MOST_MOVES):
        moved = [nuisances | {t: nuisances[t] + by for t, by in zip(times, shift, strict=True)} for shift in shifts]
        columns = judged_columns(background, model, [Point(values, amplitudes) for values in moved])
        scores = Projected(background, columns, -np.inf).scores(background.residual[:, None])[0][:, 0]
        best = moved[int(scores.argmax())]
        if scores.max() <= scores[len(shifts) // 2]:
            break
        nuisances = best
    return start | nuisances
