"""Nested test of the point of application: on the tip axis, or beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.screening.grid_search import affected_rows
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.projection import ProjectedColumns, WhitenedColumns
from diagnosis.screening.screening_cache import ScreeningCache
from diagnosis.screening.whitened_sensitivity import whitened_sensitivities
from estimation.distributions import chi2_sf
from estimation.fit import Fit, reestimated_noise, refit
from modeling.chain.effect import Effect, GridSuperposition
from modeling.chain.model import WrenchModel
from modeling.significance import LEVELS


def with_offsets_tested(fit: Fit, cache: ScreeningCache, effects: Sequence[Effect] | None = None) -> Fit:
    """The fit with x and y of its effects free where that is significantly better, and fixed at 0 where not.

    Of all its effects, or of those given.

    An effect on the tip axis is freed if the score test of x and y, given all other parameters of the fit, is
    significant, and the exact refit leaves the point within its bounds. A free one returns to the axis if a Wald test
    of x = y = 0 is not significant: another effect, added since, explains what had moved the point.
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
    """A model refitted to the recordings of a fit in their noise, re-estimated where it comes from the residual."""
    after = refit(model, before.recordings, noise=before.noise, start=start)
    if noise_from_residual(before):
        after = refit(after.model, after.recordings, noise=reestimated_noise(after), start=after.values)
    return after


def _fixed_names(effect: Effect, model: WrenchModel) -> tuple[str, ...]:
    return tuple(p.name for p in effect.qualified(model.space) if p.fixed)


def _with(model: WrenchModel, effect: Effect) -> WrenchModel:
    """The model with another form of one of its effects."""
    return replace(model, effects=tuple(effect if e.id == effect.id else e for e in model.effects))


def _score_test_p_value(fit: Fit, effect: Effect, cache: ScreeningCache) -> float:
    """P-value of the fixed parameters of one of a fit's effects, at their nominal values."""
    null_model, names = NullModel.of(fit, cache), _fixed_names(effect, fit.model)
    model = fit.model.without(effect.id) + effect.unrestricted(fit.model.space)
    choice = affected_rows(null_model, model, tested=False)
    whitened = WhitenedColumns(whitened_sensitivities(null_model, model, [{}], names, choice), choice)
    projected = ProjectedColumns(null_model, whitened, GridSuperposition.plain([{}]), -np.inf)
    return projected.test(0).p_value()


def _freed(fit: Fit, effect: Effect) -> Fit:
    """The fit with the effect's fixed parameters free; itself where one of them ends on a bound."""
    free, fixed = effect.unrestricted(fit.model.space), _fixed_names(effect, fit.model)
    after = refit_in_own_noise(fit, _with(fit.model, free), fit.values)
    inside = all(after.values[p.name] not in p.bounds for p in free.qualified(fit.model.space) if p.name in fixed)
    return after if inside else fit


def _significantly_off(fit: Fit, names: tuple[str, ...]) -> bool:
    """Whether the parameters are identifiable and differ significantly from 0."""
    place = [list(fit.parameters).index(name) for name in names]
    if not fit.identifiable[place].all():
        return False
    values, covariance = fit.theta[place], fit.covariance[np.ix_(place, place)]
    return bool(chi2_sf(values @ np.linalg.solve(covariance, values), len(place)) < LEVELS.offset)
