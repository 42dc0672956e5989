"""Schema of a custom effect's table in a TOML file or a model file, and its errors in one line."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from modeling.chain.chain import Stage
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.custom_effects.vocabulary import FORMULA_STAGES

_OTHER_STAGES = {"stage", *(stage.value.replace(" ", "_") for stage in Stage)} - set(FORMULA_STAGES)
LARGEST_ENTRY = 1e12
"""Bound on numbers in a table, SI; larger ones are typing errors."""
LONGEST_TITLE = 120
"""Characters: one line of a report."""
MOST_ENTRIES = 24
"""Parameters, inputs, constants, steps or formulas of one effect, each at most."""

MOST_VALUES = 50
"""Grid values of one nuisance parameter at most."""


class StrictEffectTable(BaseModel):
    """Base model: no other keys, no type coercion, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _bound(value: object, open_end: float) -> float:
    if value is None or value == open_end:
        return open_end
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_ENTRY:
        return float(value)
    raise ValueError("expected [low, high] with low below high")


def _bounds(value: object) -> object:
    """[low, high]; no bound is inf in TOML, null in JSON."""
    if isinstance(value, list | tuple) and len(value) == 2:
        low, high = _bound(value[0], -math.inf), _bound(value[1], math.inf)
        if low < high:
            return (low, high)
    raise ValueError("expected [low, high] with low below high")


def _search(value: object) -> object:
    """A number of values between the bounds, or the values themselves."""
    if isinstance(value, int) and not isinstance(value, bool) and 2 <= value <= MOST_VALUES:
        return value
    if isinstance(value, list | tuple) and 1 <= len(value) <= MOST_VALUES:
        return tuple(_bound(v, math.inf) for v in value)
    raise ValueError(f"expected a number of values from 2 to {MOST_VALUES}, or a list of values")


def _text(value: object) -> object:
    if isinstance(value, str) and value.strip() and value.isprintable() and len(value) <= LONGEST_TITLE:
        return value
    raise ValueError(f"expected one line of up to {LONGEST_TITLE} characters")


Text = Annotated[str, BeforeValidator(_text)]
Named = Annotated[dict[str, str], Field(max_length=MOST_ENTRIES)]


class ParameterTable(StrictEffectTable):
    """One parameter: its unit and, where they differ from the defaults, bounds, nominal value and search values."""

    unit: str
    bounds: Annotated[Any, BeforeValidator(_bounds)] = (-math.inf, math.inf)
    nominal: Annotated[float, Field(gt=-LARGEST_ENTRY, lt=LARGEST_ENTRY)] = 0.0
    search: Annotated[Any, BeforeValidator(_search)] | None = None


def _parameter(value: object) -> object:
    return {"unit": value} if isinstance(value, str) else value


def _quantity(value: object) -> object:
    return f"{float(value)!r}" if isinstance(value, int | float) and not isinstance(value, bool) else value


class EffectTable(StrictEffectTable):
    """One [[effect]], with its formulas in exactly one of the tables of `FORMULA_STAGES`."""

    id: str
    title: Text
    parameters: Annotated[
        dict[str, Annotated[ParameterTable, BeforeValidator(_parameter)]], Field(min_length=1, max_length=MOST_ENTRIES)
    ]
    inputs: Named = {}
    constants: Annotated[dict[str, Annotated[str, BeforeValidator(_quantity)]], Field(max_length=MOST_ENTRIES)] = {}
    let: Named = {}
    tip_body: Named | None = None
    gain: Named | None = None
    zero: Named | None = None
    advice: Text | None = None
    per_recording: bool = False


def read_table(data: object, where: str) -> EffectTable:
    """The validated table from plain data.

    Raises InputError, naming the key, for an invalid table.
    """
    try:
        return EffectTable.model_validate(data)
    except ValidationError as error:
        raise _input_error(error, where) from None


def _input_error(error: ValidationError, where: str) -> InputError:
    first = error.errors(include_url=False)[0]
    key = ".".join(part if part.isidentifier() else quoted(part) for part in map(str, first["loc"]))
    if first["type"] == "extra_forbidden":
        return InputError(what=f"{key}: no such key", where=where, remedy=_suggestion(first["loc"]))
    if first["type"] == "missing":
        return InputError(what=f"{key}: is missing", where=where, remedy="add it")
    message = first["msg"].removeprefix("Value error, ")
    what = f"{message}, got {quoted(first['input'])}"
    return InputError(what=f"{key}: {what}" if key else what, where=where, remedy="correct it")


def _suggestion(location: tuple[int | str, ...]) -> str:
    if len(location) > 1:
        return f"use {', '.join(ParameterTable.model_fields)}"
    if location[0] in _OTHER_STAGES:
        return f"give formulas in {', '.join(FORMULA_STAGES)}; other stages are not functions of one sample"
    return suggestion(str(location[0]), EffectTable.model_fields)
