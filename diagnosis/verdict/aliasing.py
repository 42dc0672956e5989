"""Aliases of an added effect: best fits of other effects in its place to the noise-free prediction of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.score_test import ScoreTest, absent_effects, run_searches, significant_effects
from diagnosis.selection.subset_search import CandidateModel, SubsetSearch
from estimation.fit import Fit, WhitenedProblem, initial_values
from estimation.parameter_layout import parameter_layout
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.rival_fit import RivalFit, error_probability, fit_rival
from modeling.significance import LEVELS

Array = NDArray[np.float64]

GIVE_UP_FACTOR = 100
"""Multiple of `LEVELS.confusable` above which a slowly converging refit is stopped: it cannot become an alias."""
MAX_ALIASES = 6
"""Significant effects tried in the place of another."""


@dataclass(frozen=True, eq=False)
class Alias:
    """An alternative to an added effect, and the noncentrality lambda of its best fit."""

    effect: Effect
    noncentrality: float

    @property
    def error_probability(self) -> float:
        """Probability of confusion with the added effect."""
        return error_probability(self.noncentrality)


@dataclass(frozen=True, eq=False)
class AliasProblem(WhitenedProblem):
    """Least-squares problem of one model fitted to another's whitened noise-free prediction, the `target`.

    By Levenberg-Marquardt on square-root information: a trust-region method gives the same lambda in up to ten times
    the time, as it cannot stop early where lambda stays far above that of an alias.
    """

    target: tuple[Array, ...] = ()

    @cached_property
    def measured(self) -> tuple[Array, ...]:
        """The whitened prediction to be fitted."""
        return self.target

    def fitted(self, start: Array) -> RivalFit:
        """The fit within the physical bounds; far above `LEVELS.confusable` its lambda is an upper bound."""
        found = self.minimise(start, far=GIVE_UP_FACTOR * LEVELS.confusable)
        return RivalFit(found.theta, found.cost)


@dataclass(frozen=True, eq=False)
class AliasCandidate:
    """A screened effect in the `place` (id) of an added one; `without` is the fit with the other added effects.

    free  whether no parameter of the screened effect is fixed: the added one is at a point beside the tip axis, where
          an effect on the axis could not be as good
    """

    place: str
    without: Fit
    screening: ScoreTest
    free: bool

    @property
    def model(self) -> WrenchModel:
        """The model with the screened effect in that place."""
        model, effect = self.without.model, self.screening.effect
        return model + (effect.unrestricted(model.space) if self.free else effect)


def alias_candidates(
    selection: SubsetSearch, candidate: CandidateModel, effects: Sequence[Effect]
) -> list[AliasCandidate]:
    """For each of a candidate's effects, the other effects that are significant in its place."""
    cache = candidate.cache
    places = candidate.without_each((selection.base, *selection.tried))
    others = {i: [e for e in effects if e.id != i] for i in places}
    run_searches([key for i, without in places.items() for key in absent_effects(without.fit, others[i])], cache)
    model = candidate.fit.model
    free = {e.id: e != e.restricted(model.space) for e in model.effects}
    return [
        AliasCandidate(i, without.fit, s, free[i])
        for i, without in places.items()
        for s in _most_significant(without.screened(others[i]))
    ]


def aliases(alternatives: Sequence[AliasCandidate], noncentralities: Sequence[float]) -> dict[str, list[Alias]]:
    """Alternatives to each of a candidate's effects by id, the closest first."""
    found: dict[str, list[Alias]] = {}
    for alternative, far in zip(alternatives, noncentralities, strict=True):
        if np.isfinite(far):
            found.setdefault(alternative.place, []).append(Alias(alternative.screening.effect, far))
    return {i: sorted(of, key=lambda r: r.noncentrality) for i, of in found.items()}


def _most_significant(screenings: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The significant effects with the largest scores."""
    return sorted(significant_effects(screenings), key=lambda s: -s.statistic)[:MAX_ALIASES]


def whitened_prediction(candidate: CandidateModel) -> tuple[Array, ...]:
    """The whitened noise-free prediction (rows,) of each of a candidate's recordings."""
    measured = candidate.fit.problem.measured
    residuals = np.split(candidate.null_model.whitened_residual, np.cumsum([len(m) for m in measured])[:-1])
    return tuple(m - r for m, r in zip(measured, residuals, strict=True))


def noncentrality_of_alias(target: tuple[Array, ...], alternative: AliasCandidate) -> float:
    """Noncentrality lambda of a whitened prediction, (rows,) of each recording, with respect to an alternative model.

    Infinite when the alternative has no solution at the score test's initial values.
    """
    without, screening = alternative.without, alternative.screening
    unknowns = parameter_layout(alternative.model, without.recordings)
    problem = AliasProblem(unknowns, without.recordings, without.noise, target)
    try:
        return fit_rival(problem, [initial_values(unknowns, {**without.values, **screening.start})]).noncentrality
    except InputError:
        return np.inf
