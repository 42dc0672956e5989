"""Aliases of an added effect: best fits of other effects in its place to the noise-free prediction of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

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

GIVE_UP_FACTOR = 10
"""Multiple of `LEVELS.confusable` far above which a refit is stopped once its slope does not lead below it: time for
precision, as such an alternative is none that the motions confuse, by however much they separate it."""
MAX_ALIASES = 6
"""Significant effects tried in the place of another."""


@dataclass(frozen=True, eq=False)
class Alias:
    """An alternative to an added effect.

    noncentrality  lambda of its best fit to the noise-free prediction: how far apart these motions place the two
    excess         by how much the chi-square of the readings is higher with it: how far apart these readings place them
    converged      whether that fit is a minimum; else, far above `LEVELS.confusable`, lambda is an upper bound
    """

    effect: Effect
    noncentrality: float
    excess: float
    converged: bool = True

    @property
    def error_probability(self) -> float:
        """Probability of confusion with the added effect."""
        return error_probability(self.noncentrality)

    @property
    def separated(self) -> bool:
        """Whether motions and readings separate it from the added effect, each with an error of 1 % or less."""
        return self.noncentrality >= LEVELS.separated and self.excess >= LEVELS.separated_by_readings

    @property
    def excess_in_words(self) -> str:
        """The excess, or the most that it may be, in a sentence."""
        return f"{self.excess:.3g}" if self.converged else f"up to {self.excess:.3g}"

    def to_data(self) -> dict[str, Any]:
        """The alias in result.json."""
        numbers = {"noncentrality": float(self.noncentrality), "error_probability": self.error_probability}
        return {"id": self.effect.id, **numbers, "excess": float(self.excess)}


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
        """The fit within the physical bounds; stopped early where it stays far above `LEVELS.confusable`."""
        found = self.minimise(start, far=GIVE_UP_FACTOR * LEVELS.confusable)
        return RivalFit(found.theta, found.cost, found.converged)


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
        for s in most_significant(without.screened(others[i]))
    ]


def aliases(alternatives: Sequence[AliasCandidate], fitted: Sequence[Alias | None]) -> dict[str, list[Alias]]:
    """Alternatives to each of a candidate's effects by id, the closest first; without those that were not `fitted`."""
    found: dict[str, list[Alias]] = {}
    for alternative, alias in zip(alternatives, fitted, strict=True):
        if alias is not None:
            found.setdefault(alternative.place, []).append(alias)
    return {i: sorted(of, key=lambda r: r.noncentrality) for i, of in found.items()}


def most_significant(screenings: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The significant effects with the largest scores."""
    return sorted(significant_effects(screenings), key=lambda s: -s.statistic)[:MAX_ALIASES]


@dataclass(frozen=True, eq=False)
class WhitenedModel:
    """Whitened noise-free prediction of a candidate, (rows,) of each recording, and its whitened residual (rows,)."""

    prediction: tuple[Array, ...]
    residual: Array

    @classmethod
    def of(cls, candidate: CandidateModel) -> WhitenedModel:
        """Of a candidate, from the null model of its score tests."""
        measured, residual = candidate.fit.problem.measured, candidate.null_model.whitened_residual
        parts = np.split(residual, np.cumsum([len(m) for m in measured])[:-1])
        return cls(tuple(m - r for m, r in zip(measured, parts, strict=True)), residual)


def alias_of(target: WhitenedModel, alternative: AliasCandidate) -> Alias | None:
    """The alternative fitted to a whitened prediction; None where it has no solution at the score test's values.

    Its excess is of the same values: the residual of the readings is orthogonal to what the two models share.
    """
    without, screening = alternative.without, alternative.screening
    unknowns = parameter_layout(alternative.model, without.recordings)
    problem = AliasProblem(unknowns, without.recordings, without.noise, target.prediction)
    try:
        best = fit_rival(problem, [initial_values(unknowns, {**without.values, **screening.start})])
    except InputError:
        return None
    if not np.isfinite(best.noncentrality):
        return None
    difference = problem.residual(best.theta)
    excess = float(difference @ difference + 2 * (target.residual @ difference))
    return Alias(screening.effect, best.noncentrality, excess, best.converged)
