"""Validated custom-effect definition from a table."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite, prod

import numpy as np

from modeling.effects import CATALOGUE
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.custom_effects.definition import POINT_KEY, EffectDefinition, PhysicalConstant
from modeling.formulas.custom_effects.effect_schema import LARGEST_ENTRY, EffectTable, ParameterTable
from modeling.formulas.custom_effects.parsed_formulas import parsed_formulas, require_known_signals
from modeling.formulas.custom_effects.vocabulary import (
    FORMULA_STAGES,
    is_reserved,
    signal_units,
    target_units,
    tip_units,
)
from modeling.formulas.functions import FORMULA_FUNCTIONS
from modeling.formulas.tokens import LONGEST_NAME, NAME, NUMBER
from modeling.formulas.units import dimension
from modeling.parameter import Parameter, Role
from modeling.space import Space

LARGEST_GRID = 2000
"""Grid points of the nuisance parameters: each is a score column to project, and thousands take seconds."""

_SEARCHED_ROLES = {"s": Role.ONSET, "Hz": Role.FREQUENCY}
"""Roles of the parameters with `search` by their unit: a table does not state them."""

_ID = re.compile(r"[a-z][a-z0-9_]*")
_QUANTITY = re.compile(rf"\s*([-+]?{NUMBER})\s*(.*)", re.DOTALL)


def parse_definition(table: EffectTable, where: str) -> EffectDefinition:
    """The definition in a table.

    Raises InputError, naming key and column, for names that are reserved or unknown, wrong units, syntax errors,
    unused parameters.
    """
    _require_id(table.id, where)
    _require_names(table, where)
    key = _stage_key(table, where)
    formulas: dict[str, str] = dict(getattr(table, key))
    at = formulas.pop(POINT_KEY, "") if key == "tip_body" else ""
    definition = EffectDefinition(
        id=table.id,
        title=table.title,
        stage=FORMULA_STAGES[key],
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
    _require_grid(definition, where)
    read = parsed_formulas(definition, where)
    require_known_signals(read, where)
    _require_use(definition, read.names, where)
    return definition


def _require_id(effect_id: str, where: str) -> None:
    if not _ID.fullmatch(effect_id) or len(effect_id) > LONGEST_NAME:
        remedy = "use lowercase letters, digits and _, a letter first"
        raise InputError(what=f"{quoted(effect_id)} is not a valid id", where=f"{where}: id", remedy=remedy)
    if any(effect_id == kind.id for kind in CATALOGUE):
        what = f"the catalogue has an effect '{effect_id}'"
        raise InputError(what=what, where=f"{where}: id", remedy="choose another id")


def _stage_key(table: EffectTable, where: str) -> str:
    given = [key for key in FORMULA_STAGES if getattr(table, key)]
    if len(given) == 1:
        return given[0]
    what = f"formulas were given in {' and '.join(given)}" if given else "there are no formulas"
    raise InputError(what=what, where=where, remedy=f"give them in exactly one of {', '.join(FORMULA_STAGES)}")


def _parameter(name: str, table: ParameterTable, where: str) -> Parameter:
    low, high = table.bounds
    if not low <= table.nominal <= high and not table.search:
        raise InputError(what="the nominal value is outside the bounds", where=where, remedy="correct one of them")
    nominal = min(max(table.nominal, low), high)
    role = _SEARCHED_ROLES.get(table.unit, Role.SHAPE) if table.search else Role.AMPLITUDE
    return Parameter(name=name, unit=table.unit, nominal=nominal, bounds=(low, high), role=role)


def _searched(table: ParameterTable, where: str) -> tuple[float, ...]:
    """Grid values: as listed, or equally spaced between the bounds."""
    low, high = table.bounds
    if isinstance(table.search, int):
        if not (isfinite(low) and isfinite(high)):
            remedy = "give bounds = [low, high], or list the values: search = [0, 0.1, 0.2]"
            raise InputError(what="a grid search needs finite bounds", where=where, remedy=remedy)
        return tuple(float(v) for v in np.linspace(low, high, table.search))
    values: tuple[float, ...] = tuple(table.search or ())
    if not all(low <= value <= high for value in values):
        raise InputError(what="a search value is outside the bounds", where=where, remedy="correct one of them")
    return values


def _quantity(text: str, where: str) -> PhysicalConstant:
    match = _QUANTITY.fullmatch(text)
    if match is None or abs(float(match[1])) >= LARGEST_ENTRY:
        raise InputError(what=f"{quoted(text)} is not a quantity", where=where, remedy='write it like "0.1 m"')
    return PhysicalConstant(float(match[1]), match[2].strip() or "1")


# ------------------------------------------------------------------------------------------- checks


def _require_names(table: EffectTable, where: str) -> None:
    """Names are valid identifiers, and unique."""
    taken: dict[str, str] = {name: "a signal" for space in Space for name in (*signal_units(space), *tip_units(space))}
    taken |= dict.fromkeys(FORMULA_FUNCTIONS, "a function")
    for key in ("parameters", "inputs", "constants", "let"):
        names: Mapping[str, object] = getattr(table, key)
        for name in names:
            place = f"{where}: {key}"
            if not re.fullmatch(NAME, name) or len(name) > LONGEST_NAME:
                remedy = "use letters, digits and _, a letter first"
                raise InputError(what=f"{quoted(name)} is not a valid name", where=place, remedy=remedy)
            if name in taken or name == POINT_KEY or (key == "inputs" and is_reserved(name)) or name == "pi":
                what = f"'{name}' is already {taken.get(name, 'reserved in a model')}"
                raise InputError(what=what, where=place, remedy="choose another name")
            taken[name] = f"one of {key}"


def _require_units(definition: EffectDefinition, where: str) -> None:
    """Units are valid; inputs may introduce units of their own, which parameters and constants may use."""
    own = [unit for _, unit in definition.inputs]
    for name, unit in definition.inputs:
        dimension(unit, own=own, where=f"{where}: inputs.{name}")
    for parameter in definition.parameters:
        dimension(parameter.unit, own=own, where=f"{where}: parameters.{parameter.name}")
    for name, quantity in definition.constants:
        dimension(quantity.unit, own=own, where=f"{where}: constants.{name}")


def _require_targets(definition: EffectDefinition, where: str) -> None:
    known = {name for space in Space for name in target_units(definition.stage, space)}
    for name, _ in definition.formulas:
        if name not in known:
            what = f"{quoted(name)} is not a target of this stage"
            raise InputError(what=what, where=f"{where}: {definition.key}", remedy=suggestion(name, sorted(known)))
    if not definition.formulas:
        remedy = suggestion("", sorted(known))
        raise InputError(what="there are no formulas", where=f"{where}: {definition.key}", remedy=remedy)


def _require_grid(definition: EffectDefinition, where: str) -> None:
    count = prod(len(values) for _, values in definition.search)
    if count > LARGEST_GRID:
        what = f"the search grid has {count} points"
        raise InputError(what=what, where=f"{where}: parameters", remedy=f"use {LARGEST_GRID} at most")
    if len(definition.search) == len(definition.parameters):
        remedy = "omit `search` for the amplitude of the effect"
        raise InputError(what="all parameters are nuisance parameters", where=f"{where}: parameters", remedy=remedy)


def _require_use(definition: EffectDefinition, used: frozenset[str], where: str) -> None:
    given = {"parameters": [p.name for p in definition.parameters], "inputs": list(dict(definition.inputs))}
    for key, names in (given | {"constants": list(dict(definition.constants))}).items():
        for name in names:
            if name not in used:
                what = f"'{name}' is not used in any formula"
                raise InputError(what=what, where=f"{where}: {key}.{name}", remedy="use it, or remove it")
