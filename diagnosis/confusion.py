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


def rivals(selection: Selection, candidate: Candidate, effects: Sequence[Effect]) -> dict[str, list[Rival]]:
    """For each of a candidate's effects, the others that imitate it beside its remaining effects; the closest first.

    Those that screening finds significant in its place are refitted to the candidate's noise-free prediction.
    """
    workspace, own = candidate.workspace, candidate.fit.model.effects
    places = {e.id: selection.refitted(candidate, [other for other in own if other.id != e.id]) for e in own}
    others = {i: [e for e in effects if e.id != i] for i in places}
    searched([key for i, without in places.items() for key in lacking(without.fit, others[i])], workspace)
    likely = [(i, s) for i, without in places.items() for s in _likely(without.screened(others[i]))]
    target = _prediction(candidate)
    separations = workspace.workers.map(lambda pair: separation(target, places[pair[0]].fit, pair[1]), likely)
    found: dict[str, list[Rival]] = {i: [] for i in places}
    for (i, screening), far in zip(likely, separations, strict=True):
        if np.isfinite(far):
            found[i].append(Rival(screening.effect, far))
    return {i: sorted(of, key=lambda r: r.separation) for i, of in found.items()}


def _likely(screenings: Sequence[Screening]) -> list[Screening]:
    """The significant ones that bring the most."""
    adjusted = holm(screenings)
    significant = [s for s in screenings if s.excited and adjusted[s.effect.id] < SIGNIFICANCE]
    return sorted(significant, key=lambda s: -s.statistic)[:RIVALS]


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
