"""Formulas: the trees of a definition's texts, their units checked, and the expressions that they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.errors import InputError
from modeling.formula.checking import require_unit, unit_of
from modeling.formula.expression import expression
from modeling.formula.parser import MOST_NODES, parse
from modeling.formula.source import Source
from modeling.formula.tree import Name, Node, names, nodes
from modeling.own.definition import AT, Definition
from modeling.own.vocabulary import signal_units, target_units, tip_units, tip_values
from modeling.space import Space, signals
from modeling.units import NUMBER, Dimension, dimension


@dataclass(frozen=True, eq=False)
class Formulas:
    """The trees of a definition: of the distance along the tip, of its steps in order, of what is added where."""

    definition: Definition
    at: tuple[Node, Source] | None
    steps: Mapping[str, tuple[Node, Source]]
    formulas: Mapping[str, tuple[Node, Source]]

    @property
    def names(self) -> frozenset[str]:
        """Every name in them, the steps' own left out."""
        trees = [tree for tree, _ in (*self.steps.values(), *self.formulas.values(), *([self.at] if self.at else []))]
        return frozenset().union(*map(names, trees)) - set(self.steps)

    @property
    def needs_repeats(self) -> bool:
        """A zero that moves with time looks like slow physics in a single run."""
        return self.definition.stage is Stage.ZERO and not self.names.isdisjoint({"time", "progress"})

    @cached_property
    def spaces(self) -> tuple[Space, ...]:
        """The spaces that have all that is named, and all that is added to."""
        definition, found = self.definition, []
        given = {*definition.fixed, *dict(definition.inputs)}
        for space in Space:
            known = {*given, *signal_units(space), *tip_units(space)}
            if self.names <= known and set(self.formulas) <= set(target_units(definition.stage, space)):
                found.append(space)
        return tuple(found)

    def values(self, chain: Chain, p: Mapping[str, sp.Expr]) -> tuple[dict[str, sp.Expr], sp.Expr]:
        """What is added where, and at which distance along the tip (m), with `p` for the parameters."""
        definition = self.definition
        known: dict[str, sp.Expr] = {name: sp.Float(quantity.value) for name, quantity in definition.constants}
        known |= {name: signals(name)[0] for name in self.names - set(known)} | dict(p)
        at = sp.S.Zero if self.at is None else expression(self.at[0], known, self.at[1])
        if definition.stage is Stage.TIP_BODY:
            known |= tip_values(chain, at)
        for name, (tree, source) in self.steps.items():
            known[name] = expression(tree, known, source)
        return {target: expression(tree, known, source) for target, (tree, source) in self.formulas.items()}, at


@lru_cache(maxsize=256)
def formulas_of(definition: Definition, where: str = "") -> Formulas:
    """The trees of a definition; `where` names it in an InputError for whatever is not a formula of the right unit."""
    return _Reader(definition, where or definition.id).read()


class _Reader:
    """One pass over the texts of a definition, in order: at, steps, formulas."""

    def __init__(self, definition: Definition, where: str) -> None:
        self.definition, self.where = definition, where
        self.own = frozenset(unit for _, unit in definition.inputs)
        self.units = {name: dimension(unit, own=self.own) for name, unit in definition.known.items()}
        self.weights: dict[str, int] = {}

    def read(self) -> Formulas:
        definition, at = self.definition, None
        if definition.at:
            fixed = {name: self.units[name] for name in definition.fixed}
            at = self._read(f"{definition.key}.{AT}", definition.at, fixed, dimension("m"))
        steps = {}
        for name, text in definition.steps:
            steps[name] = self._read(f"let.{name}", text, self.units, None)
            self.units[name] = unit_of(steps[name][0], self.units, steps[name][1]) or NUMBER
            self.weights[name] = self._weight(*steps[name])
        targets = {**target_units(definition.stage, Space.SPACE), **target_units(definition.stage, Space.PLANE)}
        formulas = {
            name: self._read(f"{definition.key}.{name}", text, self.units, dimension(targets[name]))
            for name, text in definition.formulas
        }
        for tree, source in formulas.values():
            self._weight(tree, source)
        return Formulas(definition, at, steps, formulas)

    def _read(
        self, key: str, text: str, units: Mapping[str, Dimension], expected: Dimension | None
    ) -> tuple[Node, Source]:
        source = Source(text, f"{self.where}: {key}")
        tree = parse(source, units)
        if expected is not None:
            require_unit(tree, units, expected, source)
        return tree, source

    def _weight(self, tree: Node, source: Source) -> int:
        """Nodes of a formula with its steps written out: twenty that each name the last twice would be a million."""
        total = sum(self.weights.get(node.name, 1) if isinstance(node, Name) else 1 for node in nodes(tree))
        if total > HEAVIEST:
            what = f"with its steps written out it has {total} numbers, names and operations"
            raise source.refusal(tree.column, what, f"keep it below {HEAVIEST}")
        return total


HEAVIEST = 4 * MOST_NODES
"""Nodes of a formula with its steps written out; SymPy and CasADi need about a second for the worst of that size."""


def require_spaces(formulas: Formulas, where: str) -> None:
    """Raise InputError when no sensor has all that the formulas name."""
    if formulas.spaces:
        return
    definition = formulas.definition
    fields = [*formulas.formulas, *sorted(formulas.names - {*definition.fixed, *dict(definition.inputs)})]
    sides = []
    for space, sensor in ((Space.PLANE, "planar"), (Space.SPACE, "six-axis")):
        known = {*target_units(definition.stage, space), *signal_units(space), *tip_units(space)}
        lacking = next(name for name in fields if name not in known)
        sides.append(f"a {sensor} sensor has no {lacking}")
    raise InputError(what=" and ".join(sides), where=where, remedy="use the names of one sensor")
