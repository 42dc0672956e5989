"""Definition of a custom effect as plain values, its formulas as text."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from math import isfinite, prod
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.effects import every_kind
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.parser import (
    FORMULA_FUNCTIONS,
    LONGEST_NAME,
    MOST_NODES,
    NAME,
    NUMBER,
    FormulaSource,
    names_in,
    nodes_in,
    parse_formula,
    to_sympy,
)
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension, require_unit, unit_of
from modeling.formulas.vocabulary import (
    FORMULA_STAGES,
    is_reserved,
    load_units,
    signal_units,
    target_units,
    tip_units,
    tip_values,
)
from modeling.parameter import Parameter, Role
from modeling.rig_schema import StrictTable, validated
from modeling.space import Space, signals

# Schema of a custom effect's table in a TOML file or a model file, and its errors in one line.


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


def _parameter_table(value: object) -> object:
    return {"unit": value} if isinstance(value, str) else value


def _quantity_text(value: object) -> object:
    return f"{float(value)!r}" if isinstance(value, int | float) and not isinstance(value, bool) else value


Quantities = Annotated[dict[str, Annotated[str, BeforeValidator(_quantity_text)]], Field(max_length=MOST_ENTRIES)]


class EffectTable(StrictTable):
    """One [[effect]], with its formulas in exactly one of the tables of `FORMULA_STAGES`."""

    id: str
    title: Text
    parameters: Annotated[
        dict[str, Annotated[ParameterTable, BeforeValidator(_parameter_table)]],
        Field(min_length=1, max_length=MOST_ENTRIES),
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


POINT_KEY = "at"
"""Key of the distance along the tip among the formulas of the tip body."""


@dataclass(frozen=True)
class PhysicalConstant:
    """A number with a unit."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value!r} {self.unit}"


@dataclass(frozen=True)
class EffectDefinition:
    """Names, units and formulas; see `CustomEffect` for their meaning.

    parameters   of the effect
    search       grid values of each nuisance parameter, by name
    inputs       columns of the recording with their unit
    constants    numbers with a unit
    steps        intermediate variables: formulas that later ones may use
    at           formula of the distance (m) along the tip at which world forces act, empty for the sensor origin
    formulas     added terms by target
    remark       the author's advice for checks on the rig
    """

    id: str
    title: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    search: tuple[tuple[str, tuple[float, ...]], ...]
    inputs: tuple[tuple[str, str], ...]
    constants: tuple[tuple[str, PhysicalConstant], ...]
    steps: tuple[tuple[str, str], ...]
    at: str
    formulas: tuple[tuple[str, str], ...]
    remark: str
    per_recording: bool

    @property
    def unit_by_name(self) -> dict[str, str]:
        """Unit by name, steps excluded: parameters, inputs, constants, signals, the point on the tip."""
        units: dict[str, str] = {}
        for space in Space:
            units |= load_units(self.stage, space)
        units |= self.fixed | dict(self.inputs)
        for space in Space:
            units |= {**tip_units(space), **signal_units(space)}
        return units

    @property
    def fixed(self) -> dict[str, str]:
        """Unit by name of the quantities that are constant during a recording."""
        return {p.name: p.unit for p in self.parameters} | {name: q.unit for name, q in self.constants}

    @property
    def nuisance_grid(self) -> tuple[dict[str, float], ...]:
        """Every combination of the values of the nuisance parameters."""
        names = [name for name, _ in self.search]
        return tuple(dict(zip(names, row, strict=True)) for row in product(*(values for _, values in self.search)))

    @property
    def key(self) -> str:
        """The key of the table with the formulas."""
        return next(key for key, stage in FORMULA_STAGES.items() if stage is self.stage)

    @property
    def equation(self) -> str:
        """The formulas as written."""
        where = [f"{name} = {text}" for name, text in self.steps] + [f"at = {self.at}"] * bool(self.at)
        added = ", ".join(self._added(name, text) for name, text in self.formulas)
        return f"{added}, where {', '.join(where)}" if where else added

    def _added(self, name: str, text: str) -> str:
        row, _, column = name.partition("_")
        return f"{row} += ({text}) {column}" if self.stage is Stage.GAIN else f"{name} += {text}"

    @property
    def advice(self) -> str:
        """Checks to make on the rig."""
        return self.remark or "it is a custom effect: check on the rig whether its cause is present"

    def to_data(self) -> dict[str, Any]:
        """The table of this definition, as plain data: numbers are finite, or None for no bound."""
        search = dict(self.search)
        parameters = {p.name: _parameter_data(p, search.get(p.name)) for p in self.parameters}
        data = {
            "id": self.id,
            "title": self.title,
            "parameters": parameters,
            "inputs": dict(self.inputs),
            "constants": {name: str(quantity) for name, quantity in self.constants},
            "let": dict(self.steps),
            self.key: ({POINT_KEY: self.at} if self.at else {}) | dict(self.formulas),
            "advice": self.remark,
            "per_recording": self.per_recording,
        }
        return {name: value for name, value in data.items() if value not in ({}, "", False)}


def _parameter_data(parameter: Parameter, search: tuple[float, ...] | None) -> dict[str, Any]:
    data: dict[str, Any] = {"unit": parameter.unit}
    if parameter.bounds != (-math.inf, math.inf):
        data["bounds"] = [b if math.isfinite(b) else None for b in parameter.bounds]
    if parameter.nominal and search is None:
        data["nominal"] = parameter.nominal
    return data if search is None else data | {"search": list(search)}


# Syntax trees of a custom effect's formulas, with units checked, and their SymPy expressions.


@dataclass(frozen=True, eq=False)
class ParsedFormulas:
    """Syntax trees of a definition: the distance along the tip, its steps in order, its formulas by target."""

    definition: EffectDefinition
    at: tuple[ast.expr, FormulaSource] | None
    steps: Mapping[str, tuple[ast.expr, FormulaSource]]
    formulas: Mapping[str, tuple[ast.expr, FormulaSource]]

    @property
    def names(self) -> frozenset[str]:
        """Every name in them, except those of steps."""
        trees = [tree for tree, _ in (*self.steps.values(), *self.formulas.values(), *([self.at] if self.at else []))]
        return frozenset().union(*map(names_in, trees)) - set(self.steps)

    @property
    def needs_repeats(self) -> bool:
        """A bias that varies with time is aliased with slow physics in a single run: repeats are needed."""
        return self.definition.stage is Stage.BIAS and not self.names.isdisjoint({"time", "progress"})

    @cached_property
    def spaces(self) -> tuple[Space, ...]:
        """The spaces that have all names and targets of the formulas."""
        definition, suitable = self.definition, []
        given = {*definition.fixed, *dict(definition.inputs)}
        for space in Space:
            names = {*given, *signal_units(space), *tip_units(space), *load_units(definition.stage, space)}
            if self.names <= names and set(self.formulas) <= set(target_units(definition.stage, space)):
                suitable.append(space)
        return tuple(suitable)

    def values(self, chain: Chain, p: Mapping[str, sp.Expr]) -> tuple[dict[str, sp.Expr], sp.Expr]:
        """Expressions by target, and the distance along the tip (m), with expressions `p` of the parameters."""
        definition = self.definition
        expressions: dict[str, sp.Expr] = {name: sp.Float(quantity.value) for name, quantity in definition.constants}
        expressions |= {name: signals(name)[0] for name in self.names - set(expressions)} | dict(p)
        at = sp.S.Zero if self.at is None else to_sympy(self.at[0], expressions, self.at[1])
        if definition.stage is Stage.TIP_BODY:
            expressions |= tip_values(chain, at)
        for name, (tree, source) in self.steps.items():
            expressions[name] = to_sympy(tree, expressions, source)
        return {target: to_sympy(tree, expressions, source) for target, (tree, source) in self.formulas.items()}, at


@lru_cache(maxsize=256)
def parsed_formulas(definition: EffectDefinition, where: str = "") -> ParsedFormulas:
    """The syntax trees of a definition; `where` names it in an InputError for a wrong formula or unit."""
    return _DefinitionReader(definition, where or definition.id).read()


class _DefinitionReader:
    """One pass over the texts of a definition, in order: at, steps, formulas."""

    def __init__(self, definition: EffectDefinition, where: str) -> None:
        self.definition, self.where = definition, where
        self.own_units = frozenset(unit for _, unit in definition.inputs)
        self.units = {name: dimension(unit, own_units=self.own_units) for name, unit in definition.unit_by_name.items()}
        self.sizes: dict[str, int] = {}

    def read(self) -> ParsedFormulas:
        definition, at = self.definition, None
        if definition.at:
            fixed = {name: self.units[name] for name in definition.fixed}
            at = self._read(f"{definition.key}.{POINT_KEY}", definition.at, fixed, dimension("m"))
        steps = {}
        for name, text in definition.steps:
            steps[name] = self._read(f"let.{name}", text, self.units, None)
            self.units[name] = unit_of(steps[name][0], self.units, steps[name][1]) or DIMENSIONLESS
            self.sizes[name] = self._require_size(*steps[name])
        targets = {**target_units(definition.stage, Space.SPACE), **target_units(definition.stage, Space.PLANE)}
        formulas = {
            name: self._read(f"{definition.key}.{name}", text, self.units, dimension(targets[name]))
            for name, text in definition.formulas
        }
        for tree, source in formulas.values():
            self._require_size(tree, source)
        return ParsedFormulas(definition, at, steps, formulas)

    def _read(
        self, key: str, text: str, units: Mapping[str, Dimension], expected: Dimension | None
    ) -> tuple[ast.expr, FormulaSource]:
        source = FormulaSource(text, f"{self.where}: {key}")
        tree = parse_formula(source, units)
        if expected is not None:
            require_unit(tree, units, expected, source)
        return tree, source

    def _require_size(self, tree: ast.expr, source: FormulaSource) -> int:
        """Nodes of a formula with its steps expanded: twenty that each use the last twice would be a million."""
        total = sum(self.sizes.get(node.id, 1) if isinstance(node, ast.Name) else 1 for node in nodes_in(tree))
        if total > MOST_EXPANDED_NODES:
            what = f"with its steps expanded it has {total} numbers, names and operations"
            raise source.error(tree.col_offset, what, f"keep it below {MOST_EXPANDED_NODES}")
        return total


MOST_EXPANDED_NODES = 4 * MOST_NODES
"""Nodes of a formula with its steps expanded; SymPy and CasADi need about a second for the worst of that size."""


def require_known_signals(formulas: ParsedFormulas, where: str) -> None:
    """Raise InputError when no sensor has all names and targets of the formulas."""
    if formulas.spaces:
        return
    definition = formulas.definition
    fields = [*formulas.formulas, *sorted(formulas.names - {*definition.fixed, *dict(definition.inputs)})]
    sides = []
    for space, sensor in ((Space.PLANE, "planar"), (Space.SPACE, "six-axis")):
        names = {*target_units(definition.stage, space), *signal_units(space), *tip_units(space)}
        missing = next(name for name in fields if name not in names)
        sides.append(f"a {sensor} sensor has no {missing}")
    raise InputError(what=" and ".join(sides), where=where, remedy="use the names of one sensor")


# Validated custom-effect definition from a table.


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
    if any(effect_id == kind.id for kind in every_kind()):
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
    own_units = [unit for _, unit in definition.inputs]
    for name, unit in definition.inputs:
        dimension(unit, own_units=own_units, where=f"{where}: inputs.{name}")
    for parameter in definition.parameters:
        dimension(parameter.unit, own_units=own_units, where=f"{where}: parameters.{parameter.name}")
    for name, quantity in definition.constants:
        dimension(quantity.unit, own_units=own_units, where=f"{where}: constants.{name}")


def _require_targets(definition: EffectDefinition, where: str) -> None:
    targets = {name for space in Space for name in target_units(definition.stage, space)}
    for name, _ in definition.formulas:
        if name not in targets:
            what = f"{quoted(name)} is not a target of this stage"
            raise InputError(what=what, where=f"{where}: {definition.key}", remedy=suggestion(name, sorted(targets)))
    if not definition.formulas:
        remedy = suggestion("", sorted(targets))
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
