"""Defining: from the table that a person wrote to a definition, or to a line that says what is wrong with it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from math import isfinite, prod

import numpy as np

from modeling.effects import CATALOGUE
from modeling.errors import InputError
from modeling.formula.functions import FUNCTIONS
from modeling.formula.tokens import LONGEST_NAME
from modeling.own.definition import AT, Definition, Quantity
from modeling.own.formulas import formulas_of, require_spaces
from modeling.own.table import LARGEST, EffectTable, ParameterTable
from modeling.own.vocabulary import STAGES, is_reserved, signal_units, target_units, tip_units
from modeling.parameter import Parameter
from modeling.shown import shown
from modeling.space import Space
from modeling.units import dimension

MOST_TRIALS = 2000
"""Combinations of searched values: each is a column to project, and thousands take seconds."""

_ID = re.compile(r"[a-z][a-z0-9_]*")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_QUANTITY = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(.*)", re.DOTALL)


def defined(table: EffectTable, where: str) -> Definition:
    """The definition in a table.

    Raises InputError, naming key and column, for names that are taken or unknown, units that do not agree, formulas
    that are none, parameters that are nowhere used.
    """
    _require_id(table.id, where)
    _require_names(table, where)
    key = _stage_key(table, where)
    formulas: dict[str, str] = dict(getattr(table, key))
    at = formulas.pop(AT, "") if key == "tip_body" else ""
    definition = Definition(
        id=table.id,
        title=table.title,
        stage=STAGES[key],
        parameters=tuple(_parameter(name, p, f"{where}: parameters.{name}") for name, p in table.parameters.items()),
        search=tuple((n, _searched(p, f"{where}: parameters.{n}")) for n, p in table.parameters.items() if p.search),
        inputs=tuple(table.inputs.items()),
        constants=tuple((n, _quantity(text, f"{where}: constants.{n}")) for n, text in table.constants.items()),
        steps=tuple(table.let.items()),
        at=at,
        formulas=tuple(formulas.items()),
        remark=table.advice or "",
        per_recording=table.per_recording,
    )
    _require_units(definition, where)
    _require_targets(definition, where)
    _require_trials(definition, where)
    read = formulas_of(definition, where)
    require_spaces(read, where)
    _require_use(definition, read.names, where)
    return definition


def _require_id(effect_id: str, where: str) -> None:
    if not _ID.fullmatch(effect_id) or len(effect_id) > LONGEST_NAME:
        remedy = "use small letters, digits and _, a letter first"
        raise InputError(what=f"{shown(effect_id)} is no id", where=f"{where}: id", remedy=remedy)
    if any(effect_id == kind.id for kind in CATALOGUE):
        what = f"the catalogue has an effect '{effect_id}'"
        raise InputError(what=what, where=f"{where}: id", remedy="give yours another id")


def _stage_key(table: EffectTable, where: str) -> str:
    given = [key for key in STAGES if getattr(table, key)]
    if len(given) == 1:
        return given[0]
    what = f"formulas in {' and '.join(given)} came" if given else "there are no formulas"
    raise InputError(what=what, where=where, remedy=f"give them in one of {', '.join(STAGES)}")


def _parameter(name: str, table: ParameterTable, where: str) -> Parameter:
    low, high = table.bounds
    if not low <= table.nominal <= high and not table.search:
        raise InputError(what="the nominal value lies outside of the bounds", where=where, remedy="correct one of them")
    nominal = min(max(table.nominal, low), high)
    return Parameter(name=name, unit=table.unit, nominal=nominal, bounds=(low, high), nuisance=table.search is not None)


def _searched(table: ParameterTable, where: str) -> tuple[float, ...]:
    """The values to search: as listed, or evenly spaced between the bounds."""
    low, high = table.bounds
    if isinstance(table.search, int):
        if not (isfinite(low) and isfinite(high)):
            remedy = "give bounds = [low, high], or list the values: search = [0, 0.1, 0.2]"
            raise InputError(what="a search needs an interval", where=where, remedy=remedy)
        return tuple(float(v) for v in np.linspace(low, high, table.search))
    values: tuple[float, ...] = tuple(table.search or ())
    if not all(low <= value <= high for value in values):
        raise InputError(what="a value to search lies outside of the bounds", where=where, remedy="correct one of them")
    return values


def _quantity(text: str, where: str) -> Quantity:
    match = _QUANTITY.fullmatch(text)
    if match is None or abs(float(match[1])) >= LARGEST:
        raise InputError(what=f"{shown(text)} is no quantity", where=where, remedy='write it like "0.1 m"')
    return Quantity(float(match[1]), match[2].strip() or "1")


# ------------------------------------------------------------------------------------------- checks


def _require_names(table: EffectTable, where: str) -> None:
    """Names are plain, and each means one thing."""
    taken: dict[str, str] = {name: "a signal" for space in Space for name in (*signal_units(space), *tip_units(space))}
    taken |= dict.fromkeys(FUNCTIONS, "a function")
    for key in ("parameters", "inputs", "constants", "let"):
        names: Mapping[str, object] = getattr(table, key)
        for name in names:
            place = f"{where}: {key}"
            if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
                remedy = "use letters, digits and _, a letter first"
                raise InputError(what=f"{shown(name)} is no name", where=place, remedy=remedy)
            if name in taken or name == AT or (key == "inputs" and is_reserved(name)) or name == "pi":
                what = f"'{name}' is {taken.get(name, 'something else in a model')} already"
                raise InputError(what=what, where=place, remedy="use another name")
            taken[name] = f"one of {key}"


def _require_units(definition: Definition, where: str) -> None:
    """Units can be read; those of inputs may be any, and the others those of inputs too."""
    own = [unit for _, unit in definition.inputs]
    for name, unit in definition.inputs:
        dimension(unit, own=own, where=f"{where}: inputs.{name}")
    for parameter in definition.parameters:
        dimension(parameter.unit, own=own, where=f"{where}: parameters.{parameter.name}")
    for name, quantity in definition.constants:
        dimension(quantity.unit, own=own, where=f"{where}: constants.{name}")


def _require_targets(definition: Definition, where: str) -> None:
    known = {name for space in Space for name in target_units(definition.stage, space)}
    for name, _ in definition.formulas:
        if name not in known:
            what = f"nothing is added to {shown(name)}"
            raise InputError(what=what, where=f"{where}: {definition.key}", remedy=_meant(name, known))
    if not definition.formulas:
        raise InputError(what="there are no formulas", where=f"{where}: {definition.key}", remedy=_meant("", known))


def _meant(name: str, known: Iterable[str]) -> str:
    choices = sorted(known)
    close = get_close_matches(name, choices, n=1)
    return f"did you mean {close[0]}?" if close else f"use {', '.join(choices[:12])}{', ..' * (len(choices) > 12)}"


def _require_trials(definition: Definition, where: str) -> None:
    trials = prod(len(values) for _, values in definition.search)
    if trials > MOST_TRIALS:
        what = f"{trials} combinations of values would be searched"
        raise InputError(what=what, where=f"{where}: parameters", remedy=f"search fewer values: {MOST_TRIALS} at most")
    if len(definition.search) == len(definition.parameters):
        remedy = "leave `search` out where a parameter says how large the effect is"
        raise InputError(what="all parameters are searched", where=f"{where}: parameters", remedy=remedy)


def _require_use(definition: Definition, used: frozenset[str], where: str) -> None:
    given = {"parameters": [p.name for p in definition.parameters], "inputs": list(dict(definition.inputs))}
    for key, names in (given | {"constants": list(dict(definition.constants))}).items():
        for name in names:
            if name not in used:
                what = f"'{name}' is in no formula"
                raise InputError(what=what, where=f"{where}: {key}.{name}", remedy="use it, or remove it")
