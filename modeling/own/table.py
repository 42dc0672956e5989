"""Table: what an effect of one's own may say of itself, in a TOML file or in the data of a model."""

from __future__ import annotations

import math
from difflib import get_close_matches
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from modeling.chain import Stage
from modeling.errors import InputError
from modeling.own.vocabulary import STAGES
from modeling.shown import shown

_OTHER_STAGES = {"stage", *(stage.value.replace(" ", "_") for stage in Stage)} - set(STAGES)
LARGEST = 1e12
"""Of a number in a table, SI; beyond are slips of the key."""
LONGEST_TITLE = 120
"""Characters: one line of a report."""
MOST_ENTRIES = 24
"""Parameters, inputs, constants, steps or formulas of one effect; a calibration matrix of six axes has 36 less six."""

MOST_VALUES = 50
"""Of one parameter that are searched."""


class Table(BaseModel):
    """No other keys, no other types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _end(value: object, open_end: float) -> float:
    if value is None or value == open_end:
        return open_end
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST:
        return float(value)
    raise ValueError("[low, high] with low below high was expected")


def _bounds(value: object) -> object:
    """[low, high], either end open: inf in TOML, null in JSON."""
    if isinstance(value, list | tuple) and len(value) == 2:
        low, high = _end(value[0], -math.inf), _end(value[1], math.inf)
        if low < high:
            return (low, high)
    raise ValueError("[low, high] with low below high was expected")


def _search(value: object) -> object:
    """A number of values between the bounds, or the values themselves."""
    if isinstance(value, int) and not isinstance(value, bool) and 2 <= value <= MOST_VALUES:
        return value
    if isinstance(value, list | tuple) and 1 <= len(value) <= MOST_VALUES:
        return tuple(_end(v, math.inf) for v in value)
    raise ValueError(f"a number of values from 2 to {MOST_VALUES}, or a list of them, was expected")


def _text(value: object) -> object:
    if isinstance(value, str) and value.strip() and value.isprintable() and len(value) <= LONGEST_TITLE:
        return value
    raise ValueError(f"one line of up to {LONGEST_TITLE} characters was expected")


Text = Annotated[str, BeforeValidator(_text)]
Named = Annotated[dict[str, str], Field(max_length=MOST_ENTRIES)]


class ParameterTable(Table):
    """One parameter: its unit, and where it differs from these, bounds, nominal value and values to search."""

    unit: str
    bounds: Annotated[Any, BeforeValidator(_bounds)] = (-math.inf, math.inf)
    nominal: Annotated[float, Field(gt=-LARGEST, lt=LARGEST)] = 0.0
    search: Annotated[Any, BeforeValidator(_search)] | None = None


def _parameter(value: object) -> object:
    return {"unit": value} if isinstance(value, str) else value


def _quantity(value: object) -> object:
    return f"{float(value)!r}" if isinstance(value, int | float) and not isinstance(value, bool) else value


class EffectTable(Table):
    """One [[effect]]; exactly one of the tables of `STAGES` holds its formulas."""

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
    """The table in plain data.

    Raises InputError, naming the key, for whatever is not one.
    """
    try:
        return EffectTable.model_validate(data)
    except ValidationError as error:
        raise _refusal(error, where) from None


def _refusal(error: ValidationError, where: str) -> InputError:
    first = error.errors(include_url=False)[0]
    key = ".".join(part if part.isidentifier() else shown(part) for part in map(str, first["loc"]))
    if first["type"] == "extra_forbidden":
        return InputError(what=f"{key}: no such key is known", where=where, remedy=_instead(first["loc"]))
    if first["type"] == "missing":
        return InputError(what=f"{key}: was expected and is missing", where=where, remedy="add it")
    message = first["msg"].removeprefix("Value error, ")
    what = f"{message}, and {shown(first['input'])} came"
    return InputError(what=f"{key}: {what}" if key else what, where=where, remedy="correct it there")


def _instead(location: tuple[int | str, ...]) -> str:
    if len(location) > 1:
        return f"use {', '.join(ParameterTable.model_fields)}"
    if location[0] in _OTHER_STAGES:
        return f"formulas stand in {', '.join(STAGES)}; other stages are no function of one sample"
    close = get_close_matches(str(location[0]), EffectTable.model_fields, n=1)
    return f"did you mean {close[0]}?" if close else f"use {', '.join(EffectTable.model_fields)}"
