"""Effects file: custom effects read from TOML, and those usable on a data set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from estimation.case import Case
from modeling.errors import InputError, file_text, quoted, toml_data
from modeling.formulas.custom_effect import CustomEffect, require_finite

MAX_BYTES = 200_000
"""Of a file: some hundred effects."""
MAX_EFFECTS = 50
"""Of a file: each is tested in a diagnosis and adds to the multiplicity correction."""
REMEDY = "write each effect as a table [[effect]]"


def read_effects(path: str | Path) -> tuple[CustomEffect, ...]:
    '''Custom effects of a TOML file, each an [[effect]] table (see `CustomEffect`), in order.

    The file is data: formulas are parsed to a syntax tree of a white list and never executed.

    Parameters
    ----------
    path : str or Path
        The effects file.

    Returns
    -------
    tuple of CustomEffect
        Effects to add to a model, or candidates of `diagnose`.

    Raises
    ------
    InputError
        In one line that names effect, key and column, for an invalid file.

    Examples
    --------
    >>> import truewrench as tw
    >>> from pathlib import Path
    >>> _ = Path("effects.toml").write_text("""
    ... [[effect]]
    ... id = "warming"
    ... title = "zero of fx follows the temperature"
    ... parameters = { slope = "N/K" }
    ... inputs = { temperature = "K" }
    ... zero = { fx = "slope * temperature" }
    ... """)
    >>> [effect.id for effect in tw.read_effects("effects.toml")]
    ['warming']
    '''
    where = str(path)
    tables = _tables(file_text(path, kind="a file of effects", most=MAX_BYTES), where)
    effects = tuple(
        CustomEffect.from_data(table, where=_location(where, table, n)) for n, table in enumerate(tables, 1)
    )
    ids = [effect.id for effect in effects]
    for number, effect_id in enumerate(ids):
        if effect_id in ids[:number]:
            what = f"the id '{effect_id}' is used twice"
            raise InputError(what=what, where=where, remedy="give each effect a unique id")
    return effects


def _tables(text: str, where: str) -> list[object]:
    data = toml_data(text, where)
    tables = data.get("effect")
    unknown = [key for key in data if key != "effect"]
    if unknown or not isinstance(tables, list) or not tables:
        what = f"{quoted(unknown[0])} is not a key of an effects file" if unknown else "it contains no effect"
        raise InputError(what=what, where=where, remedy=REMEDY)
    if len(tables) > MAX_EFFECTS:
        what = f"the file has {len(tables)} effects"
        raise InputError(what=what, where=where, remedy=f"use {MAX_EFFECTS} at most")
    return tables


def _location(where: str, table: object, number: int) -> str:
    """Location of an effect in an error: its number in the file, and its id if it has one."""
    name = table.get("id") if isinstance(table, Mapping) else None
    return f"{where}: effect {number}" + (f" ({name})" if isinstance(name, str) and name.isidentifier() else "")


def custom_candidates(path: Path | None, case: Case) -> tuple[CustomEffect, ...]:
    """Custom effects of a file that apply to the data set's sensor; none without a file.

    Raises InputError when none applies, or one is not finite on a recording.
    """
    if path is None:
        return ()
    space = case.model.space
    effects = tuple(effect for effect in read_effects(path) if space in effect.spaces)
    if not effects:
        what = f"no effect in it is for a sensor of the channels {', '.join(space.channels)}"
        raise InputError(what=what, where=str(path), remedy="use the signals and channels of these recordings")
    for effect in effects:
        for recording in (*case.recordings, *case.held_out):
            where = f"{path}, on {recording.name}"
            require_finite(effect.definition, space, recording.motion.model_signals, recording.samples, where)
    return effects
