"""Aliases of an added effect: whitened separation of best-fitting alternatives, probability of confusion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.score_test import ScoreTest, absent_effects, run_searches, significant_effects
from diagnosis.selection.subset_search import CandidateModel, SubsetSearch
from estimation.distributions import normal_cdf
from estimation.fit import Fit, WhitenedProblem, initial_values
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum, levenberg_marquardt
from estimation.parameter_layout import parameter_layout
from modeling.chain.effect import Effect
from modeling.errors import InputError

Array = NDArray[np.float64]

ALIAS_SEPARATION = 10.8
"""Squared whitened distance (lambda) below which the probability of confusing two effects exceeds 5 %."""
GIVE_UP_FACTOR = 100
"""Multiple of that separation above which a slowly converging refit is stopped: it cannot become an alias."""
MAX_ALIASES = 6
"""Significant effects tried in the place of another."""


@dataclass(frozen=True, eq=False)
class Alias:
    """An alternative to an added effect, at its best fit; `separation` is the squared whitened distance (lambda) of
    the two predictions."""

    effect: Effect
    separation: float

    @property
    def chance(self) -> float:
        """Probability of confusion, Phi(-sqrt(lambda) / 2)."""
        return float(normal_cdf(-np.sqrt(self.separation) / 2))


@dataclass(frozen=True, eq=False)
class AliasProblem(WhitenedProblem):
    """Least-squares problem of one model fitted to another's noise-free prediction."""

    target: tuple[Array, ...] = ()

    @property
    def measured(self) -> tuple[Array, ...]:
        """The whitened prediction to be fitted."""
        return self.target

    def minimise(self, start: Array) -> LeastSquaresMinimum:
        """The least-squares minimum within the physical bounds, exact unless far above ALIAS_SEPARATION."""
        low, high = (np.array([p.bounds[i] for p in self.layout.parameters]) for i in (0, 1))
        return levenberg_marquardt(self.information, start, (low, high), far=GIVE_UP_FACTOR * ALIAS_SEPARATION)


@dataclass(frozen=True, eq=False)
class AliasCandidate:
    """A screened effect in the `place` (id) of an added one; `without` is the fit with the other added effects."""

    place: str
    without: Fit
    screening: ScoreTest


def alias_candidates(
    selection: SubsetSearch, candidate: CandidateModel, effects: Sequence[Effect]
) -> list[AliasCandidate]:
    """For each of a candidate's effects, the other effects that are significant in its place."""
    workspace = candidate.workspace
    places = candidate.without_each((selection.base, *selection.tried))
    others = {i: [e for e in effects if e.id != i] for i in places}
    run_searches([key for i, without in places.items() for key in absent_effects(without.fit, others[i])], workspace)
    return [
        AliasCandidate(i, without.fit, s)
        for i, without in places.items()
        for s in _most_significant(without.screened(others[i]))
    ]


def aliases(alternatives: Sequence[AliasCandidate], separations: Sequence[float]) -> dict[str, list[Alias]]:
    """Alternatives to each of a candidate's effects by id, the closest first."""
    found: dict[str, list[Alias]] = {}
    for alternative, far in zip(alternatives, separations, strict=True):
        if np.isfinite(far):
            found.setdefault(alternative.place, []).append(Alias(alternative.screening.effect, far))
    return {i: sorted(of, key=lambda r: r.separation) for i, of in found.items()}


def _most_significant(screenings: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The significant effects with the largest scores."""
    return sorted(significant_effects(screenings), key=lambda s: -s.statistic)[:MAX_ALIASES]


def whitened_prediction(candidate: CandidateModel) -> tuple[Array, ...]:
    """The whitened noise-free prediction (rows,) of each of a candidate's recordings."""
    measured = candidate.fit.problem.measured
    residuals = np.split(candidate.null_model.whitened_residual, np.cumsum([len(m) for m in measured])[:-1])
    return tuple(m - r for m, r in zip(measured, residuals, strict=True))


def alias_separation(target: tuple[Array, ...], alternative: AliasCandidate) -> float:
    """Smallest squared whitened distance (lambda) of an alternative model from a whitened prediction.

    The model is refitted exactly to a candidate's noise-free prediction, the `target`, (rows,) of each recording. Far
    above ALIAS_SEPARATION the result is an upper bound.
    """
    without, screening = alternative.without, alternative.screening
    unknowns = parameter_layout(without.model + screening.effect, without.recordings)
    alias_problem = AliasProblem(unknowns, without.recordings, without.noise, target)
    begin = initial_values(unknowns, {**without.values, **screening.start})
    try:
        return alias_problem.minimise(begin).cost
    except InputError:
        return np.inf  # no solution at the score test's initial values
