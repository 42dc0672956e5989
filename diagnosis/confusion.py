"""Confusion: which other effects could have made what one effect is held responsible for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.price import SIGNIFICANCE
from diagnosis.screening import Screening, lacking, searched
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


@dataclass(frozen=True, eq=False)
class Contest:
    """A screened effect in the `place` of an added one, beside the remaining effects that `without` has."""

    place: str
    without: Fit
    screening: Screening


def contests_of(selection: Selection, candidate: Candidate, effects: Sequence[Effect]) -> list[Contest]:
    """Those that are to be decided: for each of a candidate's effects, the others found significant in its place."""
    workspace = candidate.workspace
    places = candidate.less_each((selection.base, *selection.tried))
    others = {i: [e for e in effects if e.id != i] for i in places}
    searched([key for i, without in places.items() for key in lacking(without.fit, others[i])], workspace)
    return [Contest(i, without.fit, s) for i, without in places.items() for s in _likely(without.screened(others[i]))]


def rivals(contests: Sequence[Contest], separations: Sequence[float]) -> dict[str, list[Rival]]:
    """For each of a candidate's effects, the others that imitate it beside its remaining effects; the closest first."""
    found: dict[str, list[Rival]] = {}
    for contest, far in zip(contests, separations, strict=True):
        if np.isfinite(far):
            found.setdefault(contest.place, []).append(Rival(contest.screening.effect, far))
    return {i: sorted(of, key=lambda r: r.separation) for i, of in found.items()}


def _likely(screenings: Sequence[Screening]) -> list[Screening]:
    """The significant ones that bring the most."""
    adjusted = holm(screenings)
    significant = [s for s in screenings if s.excited and adjusted[s.effect.id] < SIGNIFICANCE]
    return sorted(significant, key=lambda s: -s.statistic)[:RIVALS]


def prediction_of(candidate: Candidate) -> tuple[Array, ...]:
    """The whitened noise-free prediction (rows,) of each of a candidate's recordings."""
    measured = candidate.fit.problem.measured
    residuals = np.split(candidate.background.raw_residual, np.cumsum([len(m) for m in measured])[:-1])
    return tuple(m - r for m, r in zip(measured, residuals, strict=True))


def separation(target: tuple[Array, ...], contest: Contest) -> float:
    """Smallest whitened distance of a contest's model from a whitened prediction, (rows,) of each recording.

    The model is refitted exactly to a candidate's noise-free prediction, the `target`. Far beyond what is confusable
    the distance is an upper limit.
    """
    without, rival = contest.without, contest.screening
    unknowns = layout(without.model + rival.effect, without.recordings)
    imitation = Imitation(unknowns, without.recordings, without.noise, target)
    begin = start_of(unknowns, {**without.values, **rival.start})
    try:
        return imitation.minimise(begin).cost
    except InputError:
        return np.inf  # where the screening points the rival has no solution
