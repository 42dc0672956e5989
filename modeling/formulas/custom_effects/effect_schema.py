"""Schema of a custom effect's table in a TOML file or a model file, and its errors in one line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from modeling.chain.chain import Stage
from modeling.errors import InputError
from modeling.formulas.custom_effects.vocabulary import FORMULA_STAGES
from modeling.strict_table import StrictTable, validated

_OTHER_STAGES = {"stage", *(stage.value.replace(" ", "_") for stage in Stage)} - set(FORMULA_STAGES)
LARGEST_ENTRY = 1e12
"""Bound on numbers in a table, SI; larger ones are typing errors."""
LONGEST_TITLE = 120
"""Characters: one line of a report."""
MOST_ENTRIES = 24
"""Parameters, inputs, constants, steps or formulas of one effect, each at most."""

MOST_VALUES = 50
"""Grid values of one nuisance parameter at most."""


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


class ParameterTable(StrictTable):
    """One parameter: its unit and, where they differ from the defaults, bounds, nominal value and search values."""

    unit: str
    bounds: Annotated[Any, BeforeValidator(_bounds)] = (-math.inf, math.inf)
    nominal: Annotated[float, Field(gt=-LARGEST_ENTRY, lt=LARGEST_ENTRY)] = 0.0
    search: Annotated[Any, BeforeValidator(_search)] | None = None


def _parameter(value: object) -> object:
    return {"unit": value} if isinstance(value, str) else value


def _quantity(value: object) -> object:
    return f"{float(value)!r}" if isinstance(value, int | float) and not isinstance(value, bool) else value


Quantities = Annotated[dict[str, Annotated[str, BeforeValidator(_quantity)]], Field(max_length=MOST_ENTRIES)]


class EffectTable(StrictTable):
    """One [[effect]], with its formulas in exactly one of the tables of `FORMULA_STAGES`."""

    id: str
    title: Text
    parameters: Annotated[
        dict[str, Annotated[ParameterTable, BeforeValidator(_parameter)]], Field(min_length=1, max_length=MOST_ENTRIES)
    ]
    inputs: Named = Field(default_factory=dict)
    constants: Quantities = Field(default_factory=dict)
    let: Named = Field(default_factory=dict)
    tip_body: Named | None = None
    gain: Named | None = None
    zero: Named | None = None
    advice: Text | None = None
    per_recording: bool = False


def read_table(data: object, where: str) -> EffectTable:
    """The validated table from plain data.

    Raises InputError, naming the key, for an invalid table.
    """
    for key in data if isinstance(data, Mapping) else ():
        if key in _OTHER_STAGES:
            remedy = f"give formulas in {', '.join(FORMULA_STAGES)}; other stages are not functions of one sample"
            raise InputError(what=f"{key}: no such key", where=where, remedy=remedy)
    return validated(EffectTable, data, where)
