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
from estimation.linear.descent import Minimum, minimise
from modeling.effect import Effect
from modeling.errors import InputError

Array = NDArray[np.float64]

CONFUSABLE = 10.8
"""Whitened distance below which two effects are mistaken for one another more often than 1 time in 20."""
FAR = 100
"""Times that distance at which a refit that hardly moves is given up: no rival comes from there."""
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

    def minimise(self, start: Array) -> Minimum:
        """The least-squares minimum within the physical bounds, exact where the imitation is anywhere near."""
        low, high = (np.array([p.bounds[i] for p in self.layout.parameters]) for i in (0, 1))
        return minimise(self.information, start, (low, high), far=FAR * CONFUSABLE)


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
    target = _prediction(candidate)
    separations = candidate.workspace.workers.map(lambda s: separation(target, without.fit, s), likely[:RIVALS])
    found = [Rival(s.effect, far) for s, far in zip(likely, separations, strict=False)]
    return sorted((r for r in found if np.isfinite(r.separation)), key=lambda r: r.separation)


def _prediction(candidate: Candidate) -> tuple[Array, ...]:
    """The whitened noise-free prediction (rows,) of each of a candidate's recordings."""
    measured = candidate.fit.problem.measured
    residuals = np.split(candidate.background.raw_residual, np.cumsum([len(m) for m in measured])[:-1])
    return tuple(m - r for m, r in zip(measured, residuals, strict=True))


def separation(target: tuple[Array, ...], without: Fit, rival: Screening) -> float:
    """Smallest whitened distance of a model with the rival from a whitened prediction, (rows,) of each recording.

    Far beyond what is confusable it is an upper limit of it.
    """
    unknowns = layout(without.model + rival.effect, without.recordings)
    imitation = Imitation(unknowns, without.recordings, without.noise, target)
    begin = start_of(unknowns, {**without.values, **rival.start})
    try:
        return imitation.minimise(begin).cost
    except InputError:
        return np.inf  # where the screening points the rival has no solution
