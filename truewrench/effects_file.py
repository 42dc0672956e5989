"""Effects file: a TOML file in which a user has written down effects of their own."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

from modeling.errors import InputError
from modeling.own.formula_effect import FormulaEffect
from modeling.shown import shown

LARGEST = 200_000
"""Bytes of a file: some hundred effects, and nobody writes more by hand."""
MOST_EFFECTS = 50
"""Of a file; a diagnosis tries each, and pays for each in significance."""
REMEDY = "write each effect as a table [[effect]]"


def read_effects(path: str | Path) -> tuple[FormulaEffect, ...]:
    """The effects in a TOML file, each an [[effect]] table (see `FormulaEffect`), in their order.

    The file is data: formulas are parsed by a grammar of their own and never executed.
    Raises InputError, in one line that names effect, key and column, for whatever is no such file.
    """
    where = str(path)
    tables = _tables(_text(Path(path), where), where)
    effects = tuple(FormulaEffect.from_data(table, where=_place(where, table, n)) for n, table in enumerate(tables, 1))
    ids = [effect.id for effect in effects]
    for number, effect_id in enumerate(ids):
        if effect_id in ids[:number]:
            what = f"'{effect_id}' is there twice"
            raise InputError(what=what, where=where, remedy="give each effect an id of its own")
    return effects


def _text(path: Path, where: str) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        text = data.decode("utf-8-sig")
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise InputError(what=reason, where=where, remedy="give the path of a file of effects") from None
    except ValueError as error:  # not UTF-8, or a path that cannot be
        raise InputError(what=f"not a TOML file: {error}", where=where, remedy=REMEDY) from None
    if len(data) > LARGEST:
        raise InputError(what=f"has more than {LARGEST} bytes", where=where, remedy="divide it into several files")
    return text


def _tables(text: str, where: str) -> list[object]:
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        what = f"not a TOML file: {'tables are nested too deep' if isinstance(error, RecursionError) else error}"
        raise InputError(what=what, where=where, remedy="correct the TOML there") from None
    tables = data.get("effect")
    strange = [key for key in data if key != "effect"]
    if strange or not isinstance(tables, list) or not tables:
        what = f"{shown(strange[0])} is no key of such a file" if strange else "there is no effect in it"
        raise InputError(what=what, where=where, remedy=REMEDY)
    if len(tables) > MOST_EFFECTS:
        what = f"{len(tables)} effects came"
        raise InputError(what=what, where=where, remedy=f"try {MOST_EFFECTS} at most at a time")
    return tables


def _place(where: str, table: object, number: int) -> str:
    """What an effect is called in an error: its place in the file, and its id where it has one."""
    name = table.get("id") if isinstance(table, Mapping) else None
    return f"{where}: effect {number}" + (f" ({name})" if isinstance(name, str) and name.isidentifier() else "")
