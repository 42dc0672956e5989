"""Own candidates: the effects of a user's file that recordings of one sensor can be searched for."""

from __future__ import annotations

from pathlib import Path

from estimation.response import signals_of
from modeling.errors import InputError
from modeling.own.formula_effect import FormulaEffect
from modeling.own.trial import require_finite
from truewrench.case import Case
from truewrench.effects_file import read_effects


def own_candidates(path: Path | None, case: Case) -> tuple[FormulaEffect, ...]:
    """The effects of a file that exist for the case's sensor, none without a file.

    Raises InputError when there are none, or one is not finite on a recording.
    """
    if path is None:
        return ()
    space = case.model.space
    found = tuple(effect for effect in read_effects(path) if space in effect.spaces)
    if not found:
        what = f"no effect in it is for a sensor of the channels {', '.join(space.channels)}"
        raise InputError(what=what, where=str(path), remedy="use the signals and channels of these recordings")
    for effect in found:
        for recording in (*case.training, *case.validation):
            where = f"{path}, on {recording.name}"
            require_finite(effect, space, signals_of(recording), recording.samples, where)
    return found
