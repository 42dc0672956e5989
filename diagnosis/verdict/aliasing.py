"""What else could be there: upper limits of absent effects, aliases of added ones, and alternatives to given ones.

An alias is the best fit of another effect in the place of an added one to the noise-free prediction of the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import NEGLIGIBLE_SHARE
from diagnosis.screening.grid_search import affected_rows
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.score_test import ScoreTest, significant_effects
from diagnosis.screening.whitened_sensitivity import GridPoint, response_differences, score_columns, sensitivity_series
from diagnosis.subset_search import MAX_REFITS, CandidateModel, SubsetSearch
from estimation.fit import Fit, initial_values
from estimation.least_squares.problem import Problem
from estimation.model_response import model_response
from estimation.parameter_layout import ParameterLayout, parameter_layout
from modeling.chain.effect import Effect
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.rival_fit import RivalFit, error_probability, fit_rival
from modeling.significance import LEVELS

# Upper 95 % limit of an absent effect's contribution to each channel.


Array = NDArray[np.float64]

LIMIT_STD = 1.96
"""Standard deviations beyond an estimate: the upper end of a two-sided interval of 95 %, as others have (`LEVELS`)."""


def contribution_upper_limit(
    fitted: Fit, screening: ScoreTest, cache: ScreeningCache | None = None
) -> Mapping[str, float]:
    """Upper 95 % limit of an effect's contribution to each channel, as RMS over the first recording it acts in.

    The contribution is the part not collinear with the model's other parameters, at the effect's best grid point. In
    each principal direction of the whitened columns the amount is its absolute estimate plus `LIMIT_STD` deviations.
    """
    point = screening.point
    if point is None:
        raise ValueError("an effect that is not excited has no upper limit")
    null_model = (ScreeningCache() if cache is None else cache).null_model(fitted)
    model = fitted.model + screening.effect
    unknowns = parameter_layout(model, fitted.recordings)
    number = next(i for i, m in enumerate(unknowns.models) if screening.effect.id in [e.id for e in m.effects])
    choice = affected_rows(fitted, model, tested=False)
    projected = ProjectedColumns.of_point(null_model, score_columns(fitted, model, [point], choice), choice)
    directions = projected.roots[0] / projected.scale[0][:, None]
    columns, (residual, _) = projected.columns(0), null_model.rows_of(choice)
    standardised = directions.T @ columns.T @ residual
    each = _unwhitened_columns(null_model, unknowns, number, point, null_model.spread(columns, choice))
    gram = np.stack([raw.T @ raw / len(raw) for raw in each])
    power = np.einsum("ab,cad,db->cb", directions, gram, directions, optimize=True)
    present = np.linalg.norm(directions, axis=0) > 0
    limit = np.sqrt((power * np.where(present, np.abs(standardised) + LIMIT_STD, 0.0) ** 2).sum(axis=1))
    return {c: float(v) for c, v in zip(fitted.recordings[number].channels, limit, strict=True)}


def _unwhitened_columns(
    null_model: NullModel, unknowns: ParameterLayout, number: int, point: GridPoint, columns: Array
) -> Iterator[Array]:
    """Of each channel the effect's derivatives (n, a) in its unit, less their part collinear with other parameters.

    Over one repeat where all of them are periodic, else over the whole record.
    """
    fitted = null_model.fit
    recording = fitted.recordings[number]
    theta = unknowns.values_of(number, {**fitted.values, **point.nuisances})
    collinear = null_model.directions.amounts(columns[null_model.reached])[fitted.layout.index[number]]
    every = np.eye(len(point.amplitudes))
    summands = [(series, -collinear, periodic) for series, periodic in null_model.derivatives[number]]
    of_effect = _effect_derivatives(fitted, unknowns, number, point, theta)
    summands += [(series, every[places], periodic) for series, places, periodic in of_effect]
    once, channels = summands[0][0].shape[:2]
    repeats = 1 if all(periodic for _, _, periodic in summands) else recording.repeats
    for channel in range(channels):
        raw = np.zeros((repeats, once, len(every)))
        for series, weights, periodic in summands:
            raw += (series[:, channel] @ weights).reshape(1 if periodic else repeats, once, -1)
        yield raw.reshape(-1, len(every))


def _effect_derivatives(
    fit: Fit, unknowns: ParameterLayout, number: int, point: GridPoint, theta: Array
) -> list[tuple[Array, list[int], bool]]:
    """Summands (n, p, c) of an effect's derivatives or finite differences in a recording.

    With each the indices of its amplitudes, and whether it is over one repeat (True) or the whole record (False).
    """
    recording, model = fit.recordings[number], unknowns.models[number]
    place = {p.name: i for i, p in enumerate(model.parameters)}
    differentiated = [i for i, p in enumerate(point.amplitudes) if p not in point.named]
    which = tuple(place[point.amplitudes[i].name] for i in differentiated)
    prediction = compiled_prediction(model)
    summands: list[tuple[Array, list[int], bool]] = []
    if which and (prediction.deflection is not None or set(which) & set(prediction.transfer_parameters)):
        response = model_response(model, recording, theta)
        periodic = response.whole is None
        derivative = response.periodic[1] if periodic else response.derivative
        summands.append((derivative[:, :, list(which)], differentiated, periodic))
    elif which:
        for summand in sensitivity_series(model, recording, theta[None], which):
            summands.append((summand.read()[:, :, 0], differentiated, summand.periodic))
    for _, amplitude, difference in response_differences(fit, unknowns, number, [point]):
        summands += [(summand.series[:, :, None], [amplitude], summand.periodic) for summand in difference]
    return summands


def channel_tolerance(base: Fit) -> tuple[dict[str, float], bool]:
    """Tolerance per channel as stated in the rig, else a tenth of the noise floor; and whether it was stated."""
    recording, floor = base.recordings[0], base.noise_floor()
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, NEGLIGIBLE_SHARE * f)) for c, f in zip(recording.channels, floor, strict=True)}
    return tolerance, bool(stated)


def within_tolerance(size: Mapping[str, float], tolerance: Mapping[str, float]) -> bool:
    """Whether the size is within tolerance in every channel."""
    return all(size[c] <= tolerance[c] for c in tolerance)


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
    values         of that fit, of every parameter by name, and the effect `as_fitted`, on the tip axis or at any point
    """

    effect: Effect
    noncentrality: float
    excess: float
    converged: bool = True
    values: Mapping[str, float] = field(default_factory=dict)
    as_fitted: Effect | None = None

    @property
    def error_probability(self) -> float:
        """Probability of confusion with the added effect."""
        return error_probability(self.noncentrality)

    @property
    def confusable(self) -> bool:
        """Whether motions or readings do not tell it from the added effect, with an error above 5 %."""
        return self.noncentrality < LEVELS.confusable or self.excess < LEVELS.confusable_by_readings

    @property
    def closeness(self) -> str:
        """How close it comes, in a sentence."""
        if self.noncentrality >= LEVELS.confusable:
            higher = f"higher by {self.excess_in_words} only" if self.excess > 0 else "no higher"
            return f"the chi-square is {higher}"
        return f"separation {self.noncentrality:.2g}, probability of confusion {self.error_probability:.0%}"

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
class AliasProblem(Problem):
    """Least-squares problem of one model fitted to another's whitened noise-free prediction, the `target`.

    By Levenberg-Marquardt on square-root information: a trust-region method gives the same lambda in up to ten times
    the time, as it cannot stop early where lambda stays far above that of an alias.
    """

    target: tuple[Array, ...] = ()

    @property
    def measured(self) -> tuple[Array, ...]:
        """The whitened prediction to be fitted."""
        return self.target

    def fitted(self, start: Array) -> RivalFit:
        """The fit within the physical bounds; stopped early where it stays far above `LEVELS.confusable`."""
        minimum = self.minimise(start, far=GIVE_UP_FACTOR * LEVELS.confusable)
        return RivalFit(minimum.theta, minimum.cost, minimum.converged)


def aliases_of_added(
    selection: SubsetSearch, candidate: CandidateModel, effects: Sequence[Effect]
) -> dict[str, list[Alias]]:
    """The other effects that are significant in the place of each of a candidate's, by its id, the closest first."""
    places = candidate.without_each((selection.base, *selection.tried.values()))
    others = {i: [e for e in effects if e.id != i] for i in places}
    significant = [(i, s) for i, without in places.items() for s in most_significant(without.screened(others[i]))]
    free = {e.id: e != e.restricted(candidate.fit.model.space) for e in candidate.fit.model.effects}
    measured, residual = candidate.fit.problem.measured, candidate.null_model.whitened_residual
    each = np.split(residual, np.cumsum([len(m) for m in measured])[:-1])
    prediction = tuple(m - r for m, r in zip(measured, each, strict=True))
    aliases: dict[str, list[Alias]] = {}
    for place, screening in significant:
        alias = _alias(prediction, residual, places[place].fit, screening, free=free[place])
        if alias is not None:
            aliases.setdefault(place, []).append(alias)
    return {i: sorted(several, key=lambda r: r.noncentrality) for i, several in aliases.items()}


def most_significant(screenings: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The significant effects with the largest scores."""
    return sorted(significant_effects(screenings), key=lambda s: -s.statistic)[:MAX_ALIASES]


def _alias(
    prediction: tuple[Array, ...], residual: Array, without: Fit, screening: ScoreTest, *, free: bool
) -> Alias | None:
    """A screened effect beside a fit `without` another, fitted to the whitened prediction (rows,) of each recording.

    With its fixed parameters `free` where the other effect is at a point beside the tip axis: an effect on the axis
    could not be as good. None where it has no solution at the score test's values. Its excess is of the same values:
    the `residual` (rows,) of the readings is orthogonal to what the two models share.
    """
    effect = screening.effect.unrestricted(without.model.space) if free else screening.effect
    unknowns = parameter_layout(without.model + effect, without.recordings)
    problem = AliasProblem(unknowns, without.problem.data, prediction)
    try:
        best = fit_rival(problem, [initial_values(unknowns, {**without.values, **screening.start})])
    except InputError:
        return None
    if not np.isfinite(best.noncentrality):
        return None
    difference = problem.residual(best.theta)
    excess = float(difference @ difference + 2 * (residual @ difference))
    values = dict(zip((p.name for p in unknowns.parameters), best.theta.tolist(), strict=True))
    return Alias(screening.effect, best.noncentrality, excess, best.converged, values, effect)


# Alternatives to the effects that a model was given with: others that fit as well, or better, in their place.


@dataclass(frozen=True, eq=False)
class GivenAlternative:
    """An effect that fits about as well, or better, in the place of one that was given.

    given  id of the one given
    gain   by how much the chi-square with its Bonferroni thresholds is lower with the other, negative where higher
    """

    given: str
    effect: Effect
    gain: float

    @property
    def sentence(self) -> str:
        """Both effects, and how their fits compare."""
        fits = "fits better" if self.gain > 0 else "fits nearly as well"
        size = f"chi-square {abs(self.gain):.2g} {'lower' if self.gain > 0 else 'higher'}, thresholds included"
        return f"{self.effect.id} {fits} in the place of {self.given}, which the model began with ({size})"

    def to_data(self) -> dict[str, Any]:
        """The alternative in result.json."""
        return {"given": self.given, "id": self.effect.id, "gain": float(self.gain)}


def given_alternatives(final: CandidateModel, candidates: Sequence[Effect]) -> tuple[GivenAlternative, ...]:
    """Of each effect given: the best other one in its place, unless that is clearly worse (`LEVELS.confusable`).

    Those that are significant without it are refitted exactly, all in the noise of the final model.
    """
    best_of_each = [_best(final, given, candidates) for given in final.given]
    return tuple(best for best in best_of_each if best is not None and best.gain > -LEVELS.confusable)


def _best(final: CandidateModel, given: Effect, candidates: Sequence[Effect]) -> GivenAlternative | None:
    before = final.fit
    rest = tuple(e for e in final.given if e.id != given.id)
    without = CandidateModel(
        before.refitted(before.model.without(given.id)),
        final.candidates, final.cache, rest,
    )  # fmt: skip
    tests = most_significant(without.screened(candidates))[:MAX_REFITS]
    gains = [
        GivenAlternative(given.id, test.effect, final.criterion - new.criterion)
        for test in tests
        if (new := _refitted(without, test)) is not None
    ]
    return max(gains, key=lambda alternative: alternative.gain, default=None)


def _refitted(without: CandidateModel, test: ScoreTest) -> CandidateModel | None:
    """With the effect, in the same noise; None where the score test's initial values have no solution."""
    before = without.fit
    try:
        after = before.refitted(before.model + test.effect, {**before.values, **test.start})
    except InputError:
        return None
    return CandidateModel(after, without.candidates, without.cache, without.given)
