"""Beam search over sets of effects with exact refits, Holm-adjusted entry and backward elimination."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, isclose

import numpy as np

from diagnosis.comparison.comparison import Comparison, comparisons_of, noise_from_residual
from diagnosis.progress import CountCallback, Progress, count_progress, counted, silent
from diagnosis.screening.grid_search import affected_rows, projected_columns
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.projection import ProjectedColumns, columns_beside
from diagnosis.screening.score_test import (
    ScoreTest,
    absent_effects,
    refit_initial_values,
    run_searches,
    screen,
    significant_effects,
)
from diagnosis.screening.whitened_sensitivity import whitened_sensitivities
from estimation.fit import Fit, as_reported, in_noise_beside_pose, reestimated_noise, with_ordinary_estimate
from estimation.multiplicity import bonferroni_p_value, bonferroni_threshold, chi2_sf, chi_square_penalty
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.effects.disturbances import ThermalDrift
from modeling.effects.sensor import SensorCrosstalk
from modeling.errors import InputError
from modeling.parameter import Parameter, Role
from modeling.significance import LEVELS

# Nested test of the point of application: on the tip axis, or beside it.


def with_offsets_tested(fit: Fit, cache: ScreeningCache, effects: Sequence[Effect] | None = None) -> Fit:
    """The fit with x and y of its effects, or a width, free where that is significantly better, and fixed where not.

    Of all its effects, or of those given.

    An effect on the tip axis is freed if the score test of x and y, given all other parameters of the fit, is
    significant, and the exact refit leaves the point within its bounds. A free one returns to the axis if a Wald test
    of x = y = 0 is not significant: another effect, added since, explains what had moved the point. So does friction
    of a narrow step, whose width is tested at the one that its search begins at.
    """
    for effect in fit.model.effects if effects is None else effects:
        free, restricted = effect.unrestricted(fit.model.space), effect.restricted(fit.model.space)
        if effect != free and effect_with_offsets(fit, effect, cache) == free:
            fit = _freed(fit, effect)
        elif effect != restricted and not _significantly_off(fit, _fixed_names(restricted, fit.model)):
            fit = refit_in_own_noise(fit, _with(fit.model, restricted), fit.values)
    return fit


def effect_with_offsets(fit: Fit, effect: Effect, cache: ScreeningCache) -> Effect:
    """One of a fit's effects with its fixed parameters free if their score test is significant; else itself."""
    free = effect.unrestricted(fit.model.space)
    return free if effect != free and _score_test_p_value(fit, effect, cache) < LEVELS.offset else effect


def refit_in_own_noise(before: Fit, model: WrenchModel, start: dict[str, float]) -> Fit:
    """A model refitted to the recordings of a fit in their noise, re-estimated where it comes from the residual.

    That of a model without the play of a large hysteresis takes most of it for noise, in which other widths fit as
    well: the play is fitted by ordinary least squares first, and so is a thermal drift. So does that of an event, in
    which a transient effect hardly counts: it is fitted in the noise outside first.
    """
    if not noise_from_residual(before):
        return before.refitted(model, start)
    if any(effect.has_role(Role.ONSET, model.space) for effect in model.effects):
        before = replace(before, problem=before.problem.in_noise([noise.without_events for noise in before.noise]))
    after = before.refitted(model, start)
    slow = any(e.stage is Stage.PLAY or isinstance(e, ThermalDrift) for e in model.effects)
    after = with_ordinary_estimate(after) if slow else after
    return in_noise_beside_pose(after.in_noise(reestimated_noise(after)))


def _fixed_names(effect: Effect, model: WrenchModel) -> tuple[str, ...]:
    """Full names of the parameters that are fixed in this form of an effect, and free in another."""
    free = effect.unrestricted(model.space).qualified(model.space)
    forms = zip(effect.qualified(model.space), free, strict=True)
    return tuple(p.name for p, freed in forms if p.fixed and not freed.fixed)


def _with(model: WrenchModel, effect: Effect) -> WrenchModel:
    """The model with another form of one of its effects."""
    return replace(model, effects=tuple(effect if e.id == effect.id else e for e in model.effects))


def _score_test_p_value(fit: Fit, effect: Effect, cache: ScreeningCache) -> float:
    """P-value of the fixed parameters of one of a fit's effects, at their nominal values."""
    names = _fixed_names(effect, fit.model)
    model = fit.model.without(effect.id) + effect.unrestricted(fit.model.space)
    choice = affected_rows(fit, model, tested=False)
    start = {p.name: p.start for p in model.parameters if p.name in names and p.start is not None}
    columns = whitened_sensitivities(fit, model, [start], names, choice)
    return ProjectedColumns.of_point(cache.null_model(fit), columns, choice).test(0).p_value()


def _freed(fit: Fit, effect: Effect) -> Fit:
    """The fit with the effect's fixed parameters free; itself where one ends on a bound other than it had."""
    free, fixed = effect.unrestricted(fit.model.space), _fixed_names(effect, fit.model)
    start = {name: value for name, value in fit.values.items() if name not in fixed}
    after = refit_in_own_noise(fit, _with(fit.model, free), start)
    others = [(after.values[p.name], p) for p in free.qualified(fit.model.space) if p.name in fixed]
    inside = all(value not in p.bounds or _is_nominal(value, p) for value, p in others)
    return after if inside else fit


def _is_nominal(value: float, parameter: Parameter) -> bool:
    """Whether a parameter stays where it is fixed, as the width of a narrow step does on its bound."""
    return isclose(value, parameter.nominal, rel_tol=AT_BOUND)


def _significantly_off(fit: Fit, names: tuple[str, ...]) -> bool:
    """Whether the parameters are identifiable and differ significantly from where they are fixed.

    One that is there, such as the width of a narrow step on its bound, says nothing of the others.
    """
    places = [list(fit.parameters).index(name) for name in names]
    place = [i for i in places if fit.identifiable[i] or not _is_nominal(fit.theta[i], fit.unknowns[i])]
    if not place or not fit.identifiable[place].all():
        return False
    nominal = np.array([fit.unknowns[i].nominal for i in place])
    values, covariance = fit.theta[place] - nominal, fit.covariance[np.ix_(place, place)]
    return bool(chi2_sf(values @ np.linalg.solve(covariance, values), len(place)) < LEVELS.offset)


DEPENDENT = 1e-3
"""Share of a column's length beside others, below which its element is one of theirs, or of the tool's parameters."""
FORCE_FROM_TORQUE = "1/m"
"""Unit of such an element of crosstalk."""
AT_BOUND = 1e-9
"""Relative, of a value that an optimiser leaves on a bound."""
BEAM_WIDTH = 2
"""Sets of effects kept at each size: where two effects look alike beside the base model, the true one is in either."""
MAX_REFITS = 3
"""Significant effects refitted exactly for each set: a refit takes as long as many score tests."""
MAX_EFFECTS = 4
"""Largest set size."""


@dataclass(eq=False)
class CandidateModel:
    """A model with a set of effects, refitted exactly.

    candidates  number of candidate effects, for the multiplicity correction
    cache       cache of score tests in the same noise
    given       effects that every set has, beside those of the set: the model that the search began with
    """

    fit: Fit
    candidates: int
    cache: ScreeningCache = field(default_factory=ScreeningCache)
    given: tuple[Effect, ...] = ()
    _without: dict[str, CandidateModel] = field(default_factory=dict, init=False, repr=False)
    _screened: dict[tuple[Effect, ...], list[ScoreTest]] = field(default_factory=dict, init=False, repr=False)

    @property
    def added(self) -> tuple[Effect, ...]:
        """The effects of the set, in order of addition; without those given."""
        given = {e.id for e in self.given}
        return tuple(e for e in self.fit.model.effects if e.id not in given)

    @property
    def ids(self) -> frozenset[str]:
        """The ids of the effects of the set."""
        return frozenset(e.id for e in self.added)

    @property
    def null_model(self) -> NullModel:
        """Its fit as null model of score tests."""
        return self.cache.null_model(self.fit)

    @cached_property
    def cost(self) -> float:
        """Whitened chi-square."""
        return self.null_model.cost

    def without(self, effect_id: str) -> CandidateModel:
        """The candidate without one of its effects, refitted once."""
        if effect_id not in self._without:
            self._without[effect_id] = refit_effects(self, [e for e in self.added if e.id != effect_id])
        return self._without[effect_id]

    def without_each(self, tried: Iterable[CandidateModel] = ()) -> dict[str, CandidateModel]:
        """The candidate without each of its effects in turn, by effect id; refitted unless `tried`."""
        in_same_noise = {c.ids: c for c in tried if c.fit.is_in_noise_of(self.fit)}
        return {e.id: in_same_noise.get(self.ids - {e.id}) or self.without(e.id) for e in self.added}

    def screened(self, effects: Sequence[Effect]) -> list[ScoreTest]:
        """Score tests of the effects that it lacks; those of the same effects are made once."""
        key = tuple(effects)
        if key not in self._screened:
            self._screened[key] = screen(self.fit, effects, cache=self.cache)
        return list(self._screened[key])

    @cached_property
    def lack_of_fit(self) -> float:
        """P-value of lack of fit in any recording, Bonferroni-corrected for their number."""
        return bonferroni_p_value([c.lack_of_fit for c in self.comparisons])

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Its recordings with the prediction of its fit."""
        return comparisons_of(self.fit)

    @cached_property
    def reported_fit(self) -> Fit:
        """Its fit as `fit` reports it."""
        return as_reported(self.fit)

    @cached_property
    def reported(self) -> tuple[Comparison, ...]:
        """Its recordings with the prediction of the reported fit."""
        return self.comparisons if self.reported_fit.theta is self.fit.theta else comparisons_of(self.reported_fit)

    @property
    def adequate(self) -> bool:
        """Whether the residual is consistent with the noise."""
        return self.lack_of_fit >= LEVELS.effect

    @property
    def freedom(self) -> int:
        """Number of its parameters that are not fixed."""
        return sum(not p.fixed for p in self.fit.unknowns)

    @property
    def excess(self) -> float:
        """Whitened chi-square in excess of its expectation under noise alone, at least 1."""
        return max(1.0, self.cost - sum(n.whitener.rows for n in self.fit.noise) + self.freedom)

    @property
    def criterion(self) -> float:
        """Selection criterion: whitened chi-square plus the Bonferroni threshold of each effect."""
        return self.cost + chi_square_penalty(self.fit.model, self.candidates)


@dataclass(eq=False)
class SubsetSearch:
    """A search over sets of effects: what it has done with each, by the ids of the set, and what it chose.

    base         the base model, with the effects given
    chosen       the set chosen
    tried        refitted as an extension; and the base model
    reduced      refitted without an effect of a larger set, and not tried
    extended     its significant extensions were looked for
    passed_over  a significant extension that was not refitted, as MAX_REFITS others of the same set had larger scores
    unsolved     a significant extension whose refit has no solution
    unconverged  the set at which the search ended, as its refit has not converged; None where it ended otherwise
    """

    base: CandidateModel
    chosen: CandidateModel
    tried: dict[frozenset[str], CandidateModel] = field(default_factory=dict)
    reduced: dict[frozenset[str], CandidateModel] = field(default_factory=dict)
    extended: set[frozenset[str]] = field(default_factory=set)
    passed_over: set[frozenset[str]] = field(default_factory=set)
    unsolved: set[frozenset[str]] = field(default_factory=set)
    unconverged: frozenset[str] | None = None

    @property
    def best(self) -> CandidateModel:
        """Of the sets tried the best by the criterion."""
        return min(self.tried.values(), key=lambda c: c.criterion)

    def without_each(self, candidate: CandidateModel) -> list[CandidateModel]:
        """The candidate without each of its effects in turn; sets that were not tried are recorded as reduced."""
        smaller = list(candidate.without_each(self.tried.values()).values())
        self.reduced.update({c.ids: c for c in smaller if c.ids not in self.tried})
        return smaller

    def refits_with(self, effect_id: str) -> list[CandidateModel]:
        """The refitted sets that have an effect, the smallest first."""
        refitted = {**self.reduced, **self.tried}
        return sorted((c for ids, c in refitted.items() if effect_id in ids), key=lambda c: len(c.ids))

    def refitted(self, candidate: CandidateModel, effects: Sequence[Effect]) -> CandidateModel:
        """The candidate with another set of effects: the tried one if in the same noise, else refitted."""
        tried = {self.base.ids: self.base, **self.tried}.get(frozenset(e.id for e in effects))
        if tried is not None and tried.fit.is_in_noise_of(candidate.fit):
            return tried
        return refit_effects(candidate, effects)


def search_subsets(
    base: Fit, effects: Sequence[Effect], progress: Progress = silent, cache: ScreeningCache | None = None
) -> SubsetSearch:
    """Beam search over sets of effects, beside those of the base model, until no further effect is significant.

    Each set is extended by the effects that are significant given those in it (score test, Holm, 1 %) and refitted
    exactly; a set whose refit has not converged is not extended. The best set by the criterion goes through backward
    elimination and is replaced by a smaller one that is as good. The `cache` is that of score tests in the base
    model's noise.
    """
    cache = ScreeningCache() if cache is None else cache
    start, own_noises = CandidateModel(base, len(effects), cache, base.model.effects), noise_from_residual(base)
    search, level = SubsetSearch(start, start, {start.ids: start}), [start]
    for _ in range(MAX_EFFECTS):
        extended = _extended_sets(level, effects, search, progress)
        if not extended:
            break
        if own_noises:
            level = [_best_of_own_noises(extended)]
        else:
            level = _best_by_criterion(extended, BEAM_WIDTH)
            if search.best.adequate:
                if search.best not in level:
                    break
                level = [search.best]
        if not level[0].fit.converged:
            search.unconverged = level[0].ids
            break
    best = level[0] if own_noises else search.best
    if len(best.ids) > 1:  # one exchange: each effect in turn is replaced by others significant given the rest
        _extended_sets(search.without_each(best), effects, search, progress)
        best = best if own_noises else search.best  # of own noises compared below, in a common one
    smaller = _backward_elimination(best, search, progress)
    search.chosen = _most_parsimonious(smaller, tuple(search.tried.values()))
    if search.chosen is not smaller and own_noises:
        search.chosen = _backward_elimination(search.chosen, search, progress)  # in the common noise
    return search


def _best_by_criterion(candidates: Sequence[CandidateModel], width: int) -> list[CandidateModel]:
    """The best by the criterion, of those whose refit converged if any did: a score test is valid at a minimum only."""
    minima = [c for c in candidates if c.fit.converged]
    return sorted(minima or candidates, key=lambda c: c.criterion)[:width]


def _names(ids: Iterable[str]) -> str:
    return " + ".join(sorted(ids))


def _most_parsimonious(best: CandidateModel, tried: Sequence[CandidateModel]) -> CandidateModel:
    """The adequate set with the fewest parameters whose chi-square is not significantly above that of the best."""
    if noise_from_residual(best.fit):
        return _best_with_common_noise(best, tried)
    alternatives = [best]
    for other in tried:
        saved = best.freedom - other.freedom
        worse = other.cost - best.cost
        if saved > 0 and worse < bonferroni_threshold(saved, best.candidates) and other.adequate:
            alternatives.append(other)
    return min(alternatives, key=lambda c: (c.freedom, c.criterion))


def _best_with_common_noise(best: CandidateModel, tried: Sequence[CandidateModel]) -> CandidateModel:
    """The best set by the criterion when all are refitted in one common noise.

    Where each set's noise is estimated from its own residual, every reduced chi-square is near one: no comparison.
    """
    return _best_in_noise_of(best, [c for c in tried if c.ids != best.ids and c.adequate])


def _best_of_own_noises(candidates: Sequence[CandidateModel]) -> CandidateModel:
    """Of sets that each have a noise of their own the best when all are refitted in that of one of them."""
    minima = [c for c in candidates if c.fit.converged] or candidates
    first = min(minima, key=lambda c: c.criterion)
    chosen = _best_in_noise_of(first, [c for c in minima if c is not first])
    return next(c for c in minima if c.ids == chosen.ids)


def _best_in_noise_of(best: CandidateModel, others: Sequence[CandidateModel]) -> CandidateModel:
    """The best by the criterion of a set and others, refitted in its noise.

    A refit stops once its slope does not lead below the criterion of the set, far above it: `levenberg_marquardt`.
    """
    refits = [refit_effects(best, c.added, c.fit.values, far=best.criterion) for c in others]
    return min([best, *refits], key=lambda c: c.criterion)


def _extended_sets(
    level: Sequence[CandidateModel], effects: Sequence[Effect], search: SubsetSearch, progress: Progress
) -> list[CandidateModel]:
    """The sets extended by one significant effect, unless tried already; they are recorded as tried."""
    given = "; ".join(_names(e.id for e in c.fit.model.effects) or "the rigid tool" for c in level)
    screen_all(level, effects, count_progress(progress, f"score tests given {given}"))
    wanted = [extension for c in level for extension in _wanted_extensions(c, effects, search)]
    extended = []
    while wanted := [extension for extension in wanted if _extended_ids(extension) not in search.tried]:
        first = list({_extended_ids(extension): extension for extension in reversed(wanted)}.values())[::-1]
        doing = "refit with " + "; ".join(_names(_extended_ids(extension)) for extension in first)
        for extension in counted(first, count_progress(progress, doing)):
            ids, new = _extended_ids(extension), _refit_extension(*extension)
            if new is None:
                search.unsolved.add(ids)
            else:
                search.tried[ids] = new
                extended.append(new)
        wanted = [extension for extension in wanted if extension not in first]
    return extended


Extension = tuple[CandidateModel, ScoreTest]
"""A candidate and a significant effect to add to it."""


def _extended_ids(extension: Extension) -> frozenset[str]:
    candidate, screening = extension
    return candidate.ids | {screening.effect.id}


def screen_all(
    level: Sequence[CandidateModel], effects: Sequence[Effect], announce: CountCallback | None = None
) -> None:
    """Run the score tests of all effects that the candidates lack, in one batch per cache."""
    for cache in {c.cache: None for c in level}:
        wanted = [key for c in level if c.cache is cache for key in absent_effects(c.fit, effects)]
        run_searches(wanted, cache, announce)


def _wanted_extensions(candidate: CandidateModel, effects: Sequence[Effect], search: SubsetSearch) -> list[Extension]:
    """The extensions by significant effects, the largest score first, at most MAX_REFITS; others are passed over."""
    significant = sorted(significant_effects(candidate.screened(effects)), key=lambda s: -s.statistic)
    extensions = [(candidate, screening) for screening in significant]
    search.extended.add(candidate.ids)
    search.passed_over.update(map(_extended_ids, extensions[MAX_REFITS:]))
    return extensions[:MAX_REFITS]


def _refit_extension(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel | None:
    """The extended set, refitted and tested; None where the initial values have no solution."""
    try:
        new = refit_with_effect(candidate, screening)
        _ = new.cost, new.lack_of_fit
    except InputError:
        return None
    return new


def refit_with_effect(candidate: CandidateModel, screening: ScoreTest) -> CandidateModel:
    """The candidate with one more effect, refitted exactly from the score test's initial values."""
    before, effect = candidate.fit, screening.effect
    start = {**before.values, **refit_initial_values(before, screening, candidate.cache)}
    if isinstance(effect, SensorCrosstalk) and all(recording.at_rest for recording in before.recordings):
        effect = with_strongest_leaks(candidate.null_model, effect)
    after = refit_in_own_noise(before, before.model + effect, start)
    given = {e.id for e in candidate.given}
    tested = with_offsets_tested(after, candidate.cache, [e for e in after.model.effects if e.id not in given])
    return CandidateModel(tested, candidate.candidates, candidate.cache, candidate.given)


def with_strongest_leaks(null_model: NullModel, effect: SensorCrosstalk) -> SensorCrosstalk:
    """The crosstalk with as few elements as lower the chi-square significantly, one after the other, one at least.

    Poses at rest do not tell all elements apart, nor many of them from the first moment, so that none would be
    identifiable beside all others. What leaks from a torque into a force is left to the forces that the tool's own
    torque is proportional to: with it crosstalk would read as every gain.
    """
    fit = null_model.fit
    projected = projected_columns(null_model, fit.model + effect, effect, [{}])
    columns, _ = columns_beside(null_model, projected.columns(0), projected.whitened.choice)
    residual, leaks = null_model.residual.copy(), list[str]()
    elements = effect.parameters(fit.model.space)
    names, least = [p.name for p in elements], bonferroni_threshold(1, len(elements))
    columns = columns * np.array([p.unit != FORCE_FROM_TORQUE for p in elements])
    sizes = np.linalg.norm(columns, axis=0)
    while True:
        length = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(length > DEPENDENT * sizes, length, np.inf)
        scores = (unit.T @ residual) ** 2
        best = int(np.argmax(scores))
        if leaks and scores[best] < least:
            return replace(effect, leaks=tuple(leaks))
        leaks.append(names[best])
        residual -= unit[:, best] * (unit[:, best] @ residual)
        columns = columns - np.outer(unit[:, best], unit[:, best] @ columns)


def refit_effects(
    candidate: CandidateModel, effects: Sequence[Effect], start: Mapping[str, float] | None = None, far: float = inf
) -> CandidateModel:
    """The candidate with another set of effects, beside those given, refitted exactly in the same noise.

    Where the chi-square stays far above `far` the refit stops early: `levenberg_marquardt`.
    """
    before = candidate.fit
    model = before.model.base + candidate.given + effects
    start = {**before.values, **(start or {})}
    after = before.refitted(model, start, far=far)
    return CandidateModel(after, candidate.candidates, candidate.cache, candidate.given)


def _backward_elimination(candidate: CandidateModel, search: SubsetSearch, progress: Progress) -> CandidateModel:
    """Drop effects one by one while that lowers the criterion."""
    if candidate.ids:
        progress(f"backward elimination: refit without each of {_names(candidate.ids)}")
    for smaller in search.without_each(candidate):
        if smaller.criterion < candidate.criterion:
            return _backward_elimination(smaller, search, progress)
    return candidate
