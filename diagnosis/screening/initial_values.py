"""Initial values of a nonlinear fit, by screening each effect in turn."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from diagnosis.screening.score_test import refit_initial_values, screen
from diagnosis.screening.screening_cache import ScreeningCache
from estimation.fit import Fit, refit
from estimation.gravity.gravity_direction import with_gravity_direction
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import with_decided_convention
from modeling.chain.effect import Effect, NuisanceValues
from modeling.chain.model import WrenchModel


def model_initial_values(model: WrenchModel, recordings: Sequence[Recording]) -> NuisanceValues:
    """Initial values by name for fitting a model to recordings; {} where the nominal values suffice.

    The effects are added to the rigid tool one after the other, in the model's order; each starts at the best point of
    its score test given those before it, and everything before it where it was fitted: far from there, effects that
    are not linear have other minima. An effect that the recordings do not excite is skipped.
    """
    case = with_gravity_direction(model, recordings)
    model, several = case.model, case.recordings
    searched = [e for e in model.effects if _needs_search(e, model)]
    if not searched:
        return {}
    found: NuisanceValues = {}
    fitted = refit(with_decided_convention(model.base, several), several)
    for effect in model.effects:
        cache = ScreeningCache()
        (screening,) = screen(fitted, [effect], cache=cache)
        if not screening.excited:
            continue
        if effect in searched:
            found |= refit_initial_values(fitted, screening, cache)
        fitted = _refit_with(fitted, effect, found) if effect not in model.effects[-1:] else fitted
    return {**fitted.values, **found}


def _needs_search(effect: Effect, model: WrenchModel) -> bool:
    return any(p.nuisance or not isfinite(p.nominal) for p in effect.parameters(model.space))


def _refit_with(fitted: Fit, effect: Effect, start: NuisanceValues) -> Fit:
    return refit(fitted.model + effect, fitted.recordings, noise=fitted.noise, start={**fitted.values, **start})
