"""Effects named on the command line: candidates of a diagnosis, and effects added to or dropped from a model."""

from __future__ import annotations

from pathlib import Path

from estimation.case import Case
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.effects import catalogue
from modeling.errors import InputError
from truewrench.commands.effects import effect_by_id


def custom_effects(path: Path | None, case: Case) -> tuple[Effect, ...]:
    """Custom effects of the effects file; none without a file."""
    if path is None:
        return ()

    from truewrench.files.effects_file import custom_candidates  # with the parser of formulas

    return custom_candidates(path, case)


def with_effects_changed(
    model: WrenchModel, add: list[str], drop: list[str], custom: tuple[Effect, ...] = ()
) -> WrenchModel:
    """The model with and without the effects of these ids, of the catalogue or custom ones.

    Raises InputError for ids that are unknown, added twice, or dropped without being in the model.
    """
    decided = {effect.id for effect in model.effects}  # by the data: a base mounted in no axis's direction
    for effect_id in (effect_id for effect_id in add if effect_id not in decided):
        model = model + effect_by_id(effect_id, custom)
    for effect_id in drop:
        if effect_id not in [effect.id for effect in model.effects]:
            remedy = "drop only what --add has added"
            raise InputError(what=f"'{effect_id}' is not in the model", where="--drop", remedy=remedy)
        model = model.without(effect_id)
    return model


def candidate_effects(
    case: Case, only: list[str], without: list[str], custom: tuple[Effect, ...] = ()
) -> tuple[Effect, ...]:
    """The candidates of a case: catalogue and custom effects, or `only` those of these ids, less those `without`.

    Raises InputError for an unknown id, for one that is not defined for these channels, and when none is left.
    """
    model = case.model
    told = catalogue(model.space, weighed=case.weighed, warmed=case.warmed)
    listed = {effect.id: effect for effect in (*told, *custom)}
    for option, ids in (("--only", only), ("--without", without)):
        for effect_id in ids:
            if effect_by_id(effect_id, custom).id not in listed:
                remedy = "see `truewrench effects` for where each applies"
                what = f"'{effect_id}' is not defined for {len(model.channels)} channels"
                raise InputError(what=what, where=option, remedy=remedy)
    chosen = [listed[i] for i in dict.fromkeys(only or listed) if i not in without]
    if not [effect for effect in chosen if effect.id not in {e.id for e in model.effects}]:
        remedy = "name an effect that is neither given nor left out"
        raise InputError(what="no candidate effect is left", where="--only, --without", remedy=remedy)
    return tuple(chosen)
