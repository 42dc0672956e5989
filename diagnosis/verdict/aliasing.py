"""Aliases of an added effect: best fits of other effects in its place to the noise-free prediction of the model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.grid_search import affected_rows
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.score_test import ScoreTest, absent_effects, run_searches, significant_effects
from diagnosis.screening.whitened_sensitivity import GridPoint, response_differences, score_columns, sensitivity_series
from diagnosis.subset_search import MAX_REFITS, CandidateModel, SubsetSearch, refit_effects
from estimation.fit import Fit, WhitenedProblem, initial_values, refit
from estimation.model_response import model_response
from estimation.parameter_layout import ParameterLayout, parameter_layout
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.rival_fit import RivalFit, error_probability, fit_rival
from modeling.significance import LEVELS

# What the search has refitted with an effect that the final model lacks, and why no more.


BASE = "the base model"
"""Name of the set without effects."""


class FinalRefit(Enum):
    """Exact refit of the final model with one more effect, judged by the search's criterion."""

    NONE = "not refitted"
    UNCONVERGED = "not converged, and no better so far"
    NOT_SIGNIFICANT = "not significant"
    SIGNIFICANT = "significant"


@dataclass(frozen=True, kw_only=True)
class EffectRefits:
    """What the search has refitted with an effect that the final model lacks. Sets are named by their effects.

    final        the refit of the final model with it
    smallest     the smallest set that it was refitted in, empty where it was refitted in none
    explains     whether a set that it was refitted in explains the residual: lack of fit is not significant
    final_is_base  whether the final model has no added effect
    chosen       the set that the search chose, before acceptance
    left_out     whether it was in that set, and was left out as within tolerance
    unsolved     a set with it that has no solution, empty where there is none
    unconverged  the set from which the search did not go on, as its refit has not converged; empty where it did
    passed_over  whether others had larger scores, to which the refits beside one set were limited
    ended_adequate  whether the chosen set explains the residual, and its extensions were not looked for
    final_extended  whether the extensions of the final model were looked for, be it in another noise
    """

    final: FinalRefit = FinalRefit.NONE
    smallest: str = ""
    explains: bool = False
    final_is_base: bool = False
    chosen: str = BASE
    left_out: bool = False
    unsolved: str = ""
    unconverged: str = ""
    passed_over: bool = False
    ended_adequate: bool = False
    final_extended: bool = False

    @property
    def explains_nothing(self) -> bool:
        """Whether it was refitted, explains the residual in no set, and neither does any set that was accepted."""
        return bool(self.smallest) and not self.explains and self.final_is_base

    @property
    def place(self) -> str:
        """That it was significant where it was refitted beside the final model; else the smallest of other sets."""
        if self.final is FinalRefit.SIGNIFICANT:
            return ", although it is significant after the exact refit"
        return f" (the smallest: {self.smallest}; not beside the final model)"

    @property
    def early_end(self) -> str:
        """That the search ended without convergence; empty where it did not."""
        return f"; the search ended at {self.unconverged}, whose refit has not converged" if self.unconverged else ""

    @property
    def limited(self) -> str:
        """That the number of refits kept it from being tried beside other sets; empty where it did not."""
        if not self.passed_over:
            return ""
        return f"; beside other sets, of which each has at most {MAX_REFITS} refits, others had larger scores"

    @property
    def later(self) -> str:
        """Where it is significant, as it was beside none of the sets whose extensions were looked for."""
        if self.final_extended:
            return ": it is in the noise of the final model only"
        return ": it is beside the final model only; go on from that one by --given"


def effect_refits(
    selection: SubsetSearch, final: CandidateModel, effect_id: str, beside: FinalRefit = FinalRefit.NONE
) -> EffectRefits:
    """What the search has refitted with an effect, of which the refit `beside` the final model is judged already."""
    record = selection.record
    refitted = record.refits_with(effect_id)
    return EffectRefits(
        final=beside,
        smallest=_name(refitted[0].ids) if refitted else "",
        explains=any(c.adequate for c in refitted),
        final_is_base=not final.ids,
        chosen=_name(selection.chosen.ids),
        left_out=effect_id in selection.chosen.ids,
        unsolved=min((_name(ids) for ids in record.unsolved if effect_id in ids), default=""),
        unconverged=_unconverged(selection, final),
        passed_over=any(effect_id in ids for ids in record.passed_over),
        ended_adequate=selection.chosen.adequate and selection.chosen.ids not in record.extended,
        final_extended=final.ids in record.extended,
    )


def refit_beside(selection: SubsetSearch, final: CandidateModel, effect_id: str) -> CandidateModel | None:
    """The final model with one more effect, if the search has refitted it."""
    wanted = final.ids | {effect_id}
    return next((c for c in selection.record.refits_with(effect_id) if c.ids == wanted), None)


def judge_refit(larger: CandidateModel, final: CandidateModel, effect_id: str) -> FinalRefit:
    """Whether the refit with one more effect is significantly better, as backward elimination judges it.

    Both are in one noise: in that of the larger set where each has a noise of its own.
    """
    smaller = final
    if larger.fit.noise is not final.fit.noise:
        smaller = refit_effects(larger, [e for e in larger.added if e.id != effect_id])
    if larger.criterion < smaller.criterion:
        return FinalRefit.SIGNIFICANT
    return FinalRefit.NOT_SIGNIFICANT if larger.fit.converged else FinalRefit.UNCONVERGED


def _unconverged(selection: SubsetSearch, final: CandidateModel) -> str:
    """The set from which the search did not go on as its refit has not converged: the final one, or where it ended."""
    record = selection.record
    if not final.fit.converged and final.ids not in record.extended:
        return _name(final.ids)
    return "" if record.unconverged is None else _name(record.unconverged)


def _name(ids: Iterable[str]) -> str:
    return " + ".join(sorted(ids)) or BASE


# Upper 95 % limit of an absent effect's contribution to each channel.


Array = NDArray[np.float64]


def contribution_upper_limit(
    fitted: Fit, screening: ScoreTest, cache: ScreeningCache | None = None
) -> Mapping[str, float]:
    """Upper 95 % limit of an effect's contribution to each channel, as RMS over the first recording it acts in.

    The contribution is the part not collinear with the model's other parameters, at the effect's best grid point. In
    each principal direction of the whitened columns the amount is its absolute estimate plus 1.96 standard deviations.
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
    raw = _unwhitened_columns(null_model, unknowns, number, point, null_model.spread(columns, choice))
    gram = np.stack([raw[:, c].T @ raw[:, c] for c in range(raw.shape[1])]) / len(raw)
    power = np.einsum("ab,cad,db->cb", directions, gram, directions, optimize=True)
    present = np.linalg.norm(directions, axis=0) > 0
    limit = np.sqrt((power * np.where(present, np.abs(standardised) + 1.96, 0.0) ** 2).sum(axis=1))
    return {c: float(v) for c, v in zip(fitted.recordings[number].channels, limit, strict=True)}


def _unwhitened_columns(
    null_model: NullModel, unknowns: ParameterLayout, number: int, point: GridPoint, columns: Array
) -> Array:
    """The effect's derivatives (n, p, a) in the channels' units, less their part collinear with other parameters.

    Over one repeat where all of them are periodic, else over the whole record.
    """
    fitted = null_model.fit
    recording = fitted.recordings[number]
    theta = unknowns.values_of(number, {**fitted.values, **point.nuisances})
    collinear = null_model.directions.amounts(columns[null_model.reached])[fitted.layout.index[number]]
    every = list(range(len(point.amplitudes)))
    summands = [(-series @ collinear, every, periodic) for series, periodic in null_model.derivatives[number]]
    summands += _effect_derivatives(fitted, unknowns, number, point, theta)
    once, channels = summands[0][0].shape[:2]
    repeats = 1 if all(periodic for _, _, periodic in summands) else recording.repeats
    raw = np.zeros((len(every), channels, repeats, once))
    for summand, places, periodic in summands:
        for place, series in zip(places, summand.transpose(2, 1, 0), strict=True):
            raw[place] += series[:, None] if periodic else series.reshape(channels, repeats, once)
    return raw.reshape(len(every), channels, -1).transpose(2, 1, 0)


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
    recording, floor = base.recordings[0], base.noise[0].floor
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, f / 10)) for c, f in zip(recording.channels, floor, strict=True)}
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
        return f"{self.effect.id} {fits} in the place of {self.given}, which was given ({size})"

    def to_data(self) -> dict[str, Any]:
        """The alternative in result.json."""
        return {"given": self.given, "id": self.effect.id, "gain": float(self.gain)}


def given_alternatives(final: CandidateModel, candidates: Sequence[Effect]) -> tuple[GivenAlternative, ...]:
    """Of each effect given: the best other one in its place, unless that is clearly worse (`LEVELS.confusable`).

    Those that are significant without it are refitted exactly, all in the noise of the final model.
    """
    found = [_best(final, given, candidates) for given in final.given]
    return tuple(best for best in found if best is not None and best.gain > -LEVELS.confusable)


def _best(final: CandidateModel, given: Effect, candidates: Sequence[Effect]) -> GivenAlternative | None:
    before = final.fit
    rest = tuple(e for e in final.given if e.id != given.id)
    without = CandidateModel(
        refit(before.model.without(given.id), before.recordings, noise=before.noise, start=before.values),
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
        after = refit(before.model + test.effect, before.recordings, noise=before.noise,
                      start={**before.values, **test.start})  # fmt: skip
    except InputError:
        return None
    return CandidateModel(after, without.candidates, without.cache, without.given)
