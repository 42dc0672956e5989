"""Confusion: which other effects could have made what one effect is held responsible for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.price import SIGNIFICANCE
from diagnosis.screening import Screening
from diagnosis.selection import Candidate, Selection, holm
from estimation.distributions import normal_cdf
from estimation.fit import Fit, Problem, start_of
from estimation.layout import layout
from modeling.effect import Effect
from modeling.errors import InputError

Array = NDArray[np.float64]

CONFUSABLE = 10.8
"""Whitened distance below which two effects are mistaken for one another more often than 1 time in 20."""
RIVALS = 6
"""Significant effects that are tried in the place of another."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Another effect in the place of one, at its best: `separation` is the whitened distance of their predictions."""

    effect: Effect
    separation: float

    @property
    def chance(self) -> float:
        """Chance of mistaking the two, Phi(-sqrt(lambda)/2)."""
        return float(normal_cdf(-np.sqrt(self.separation) / 2))


@dataclass(frozen=True, eq=False)
class Imitation(Problem):
    """The least-squares problem of one model fitted to another's noise-free prediction."""

    target: tuple[Array, ...] = ()

    @property
    def measured(self) -> tuple[Array, ...]:
        """The whitened prediction to be imitated."""
        return self.target


def rivals(selection: Selection, candidate: Candidate, effect_id: str, effects: list[Effect]) -> list[Rival]:
    """Other effects that imitate one of a candidate's effects, the others kept; the closest first.

    Those that screening finds significant in its place are refitted to the candidate's noise-free prediction.
    """
    model = candidate.fit.model
    rest = [e for e in model.effects if e.id != effect_id]
    without = selection.refitted(candidate, rest)
    screenings = without.screened([e for e in effects if e.id != effect_id])
    adjusted = holm(screenings)
    likely = [s for s in screenings if s.excited and adjusted[s.effect.id] < SIGNIFICANCE]
    likely.sort(key=lambda s: -s.statistic)
    found = [Rival(s.effect, separation(candidate.fit, without.fit, s)) for s in likely[:RIVALS]]
    return sorted((r for r in found if np.isfinite(r.separation)), key=lambda r: r.separation)


def separation(fitted: Fit, without: Fit, rival: Screening) -> float:
    """Smallest whitened distance of a model with the rival from a fit's prediction."""
    model = without.model + rival.effect
    unknowns = layout(model, fitted.recordings)
    problem = Problem(fitted.layout, fitted.recordings, fitted.noise)
    residual, _ = problem.evaluate(fitted.theta)
    target, start = [], 0
    for measured in problem.measured:
        target.append(measured - residual[start : start + len(measured)])
        start += len(measured)
    imitation = Imitation(unknowns, fitted.recordings, fitted.noise, tuple(target))
    begin = start_of(unknowns, {**without.values, **rival.start})
    try:
        return imitation.minimise(begin).cost
    except InputError:
        return np.inf  # where the screening points the rival has no solution
