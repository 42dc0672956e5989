"""Effects named on the command line: candidates of a diagnosis, and effects added to or dropped from a model."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from truewrench.command_options.options import add_repeatable

if TYPE_CHECKING:
    from modeling.chain.effect import Effect
    from modeling.chain.model import WrenchModel
    from truewrench.files.data_set import DataSet


def add_effect_changes(command: argparse.ArgumentParser) -> None:
    """Add --add and --drop."""
    add_effect_ids(command, "--add", text="effect to add")
    add_effect_ids(command, "--drop", text="effect to remove again")


def add_candidate_choice(command: argparse.ArgumentParser) -> None:
    """Add --given, --only and --without."""
    add_effect_ids(command, "--given", "--add", text="effect that the model has already")
    add_effect_ids(command, "--only", text="candidate effect, instead of the whole catalogue")
    add_effect_ids(command, "--without", text="effect that is no candidate")


def add_effect_ids(command: argparse.ArgumentParser, *options: str, text: str) -> None:
    """Add an option that takes one id or several, and may be given several times."""
    action = add_repeatable(command, *options, metavar="ID", text=f"{text}, or several")
    action.completer = catalogue_ids  # type: ignore[attr-defined]  # of argcomplete


def catalogue_ids(**_: object) -> list[str]:
    """The ids of the catalogue's effects, for the shell to complete."""
    from modeling.effects import catalogue

    return [effect.id for effect in catalogue()]


def ids_apart(arguments: list[str], options: set[str]) -> list[str]:
    """Arguments with `--add A B` or `--add A,B` as `--add A --add B`: an id is a name, no option and no file.

    argparse itself would take the recordings that follow for ids too.
    """
    found: list[str] = []
    option, ids = "", 0
    for text in arguments:
        if text.startswith("-"):
            option, ids = text if text in options else "", 0
        elif option and ids and (not _are_ids(text) or Path(text).exists()):
            option = ""
        elif option:
            names = [name for name in text.split(",") if name] or [text]
            found += [option] * (ids > 0)
            found += [part for name in names[:-1] for part in (name, option)]
            text, ids = names[-1], ids + 1
        found.append(text)
    return found


def _are_ids(text: str) -> bool:
    """Whether these are names, separated by commas where there are several."""
    return all(name.isidentifier() for name in text.rstrip(",").split(","))


def effect_by_id(effect_id: str, custom: tuple[Effect, ...] = ()) -> Effect:
    """Effect of that id, a custom one or of the catalogue.

    Raises InputError for an unknown id.
    """
    from modeling.effects import named
    from modeling.errors import InputError

    for effect in custom:
        if effect.id == effect_id:
            return effect
    try:
        return named(effect_id)
    except InputError as error:
        also = f", or a custom effect: {', '.join(effect.id for effect in custom)}" if custom else ""
        raise InputError(what=error.what, where=error.where, remedy=error.remedy + also) from None


def custom_effects(path: Path | None, case: DataSet) -> tuple[Effect, ...]:
    """Custom effects of the effects file; none without a file."""
    if path is None:
        return ()
    from truewrench.files.effects_file import custom_candidates

    return custom_candidates(path, case)


def with_effects_changed(
    model: WrenchModel, add: list[str], drop: list[str], custom: tuple[Effect, ...] = ()
) -> WrenchModel:
    """The model with and without the effects of these ids, of the catalogue or custom ones.

    Raises InputError for ids that are unknown, added twice, or dropped without being in the model.
    """
    from modeling.errors import InputError

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
    model: WrenchModel, only: list[str], without: list[str], custom: tuple[Effect, ...] = ()
) -> tuple[Effect, ...]:
    """The candidates: catalogue and custom effects, or `only` those of these ids, less those `without`.

    Raises InputError for an unknown id, for one that is not defined for these channels, and when none is left.
    """
    from modeling.effects import catalogue
    from modeling.errors import InputError

    listed = {effect.id: effect for effect in (*catalogue(model.space), *custom)}
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
