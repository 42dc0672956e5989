"""Start: where a refit begins whose effects have a place, a time or a size that no fit can begin without."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from diagnosis.screening import beginning, screen
from diagnosis.workspace import Workspace
from estimation.convention import decided
from estimation.fit import Fit, refit
from estimation.recording import Recording
from modeling.effect import Effect, Values
from modeling.model import WrenchModel


def start_values(model: WrenchModel, recordings: Sequence[Recording]) -> Values:
    """Values by name from which the model can be fitted to the recordings; {} where the nominal ones will do.

    The effects are added to the rigid tool one after the other, in the model's order: each begins where a screening
    finds that it explains most of what those before it leave. One that the recordings do not show is left out of it.
    """
    several = tuple(recordings)
    sought = [e for e in model.effects if _has_to_be_sought(e, model)]
    if not sought:
        return {}
    found: Values = {}
    fitted = refit(decided(model.base, several), several)
    for effect in model.effects:
        workspace = Workspace()
        (screening,) = screen(fitted, [effect], workspace=workspace)
        if not screening.excited:
            continue
        if effect in sought:
            found |= beginning(fitted, screening, workspace)
        fitted = _with(fitted, effect, found) if effect not in model.effects[-1:] else fitted
    return found


def _has_to_be_sought(effect: Effect, model: WrenchModel) -> bool:
    return any(p.nuisance or not isfinite(p.nominal) for p in effect.parameters(model.space))


def _with(fitted: Fit, effect: Effect, start: Values) -> Fit:
    return refit(fitted.model + effect, fitted.recordings, noise=fitted.noise, start={**fitted.values, **start})
