"""Syntax trees of a custom effect's formulas, with units checked, and their SymPy expressions."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.errors import InputError
from modeling.formulas.custom_effects.definition import POINT_KEY, EffectDefinition
from modeling.formulas.custom_effects.vocabulary import signal_units, target_units, tip_units, tip_values
from modeling.formulas.parser import MOST_NODES, parse_formula
from modeling.formulas.sympy_expression import to_sympy
from modeling.formulas.syntax_tree import names_in, nodes_in
from modeling.formulas.tokens import FormulaSource
from modeling.formulas.unit_check import require_unit, unit_of
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension
from modeling.space import Space, signals


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
        definition, found = self.definition, []
        given = {*definition.fixed, *dict(definition.inputs)}
        for space in Space:
            known = {*given, *signal_units(space), *tip_units(space)}
            if self.names <= known and set(self.formulas) <= set(target_units(definition.stage, space)):
                found.append(space)
        return tuple(found)

    def values(self, chain: Chain, p: Mapping[str, sp.Expr]) -> tuple[dict[str, sp.Expr], sp.Expr]:
        """Expressions by target, and the distance along the tip (m), with expressions `p` of the parameters."""
        definition = self.definition
        known: dict[str, sp.Expr] = {name: sp.Float(quantity.value) for name, quantity in definition.constants}
        known |= {name: signals(name)[0] for name in self.names - set(known)} | dict(p)
        at = sp.S.Zero if self.at is None else to_sympy(self.at[0], known, self.at[1])
        if definition.stage is Stage.TIP_BODY:
            known |= tip_values(chain, at)
        for name, (tree, source) in self.steps.items():
            known[name] = to_sympy(tree, known, source)
        return {target: to_sympy(tree, known, source) for target, (tree, source) in self.formulas.items()}, at


@lru_cache(maxsize=256)
def parsed_formulas(definition: EffectDefinition, where: str = "") -> ParsedFormulas:
    """The syntax trees of a definition; `where` names it in an InputError for a wrong formula or unit."""
    return _DefinitionReader(definition, where or definition.id).read()


class _DefinitionReader:
    """One pass over the texts of a definition, in order: at, steps, formulas."""

    def __init__(self, definition: EffectDefinition, where: str) -> None:
        self.definition, self.where = definition, where
        self.own = frozenset(unit for _, unit in definition.inputs)
        self.units = {name: dimension(unit, own=self.own) for name, unit in definition.known.items()}
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
        known = {*target_units(definition.stage, space), *signal_units(space), *tip_units(space)}
        missing = next(name for name in fields if name not in known)
        sides.append(f"a {sensor} sensor has no {missing}")
    raise InputError(what=" and ".join(sides), where=where, remedy="use the names of one sensor")
