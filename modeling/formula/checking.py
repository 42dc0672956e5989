"""Checking: the unit of a formula, found node by node, so that a wrong one can be pointed at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

from modeling.formula.functions import UnitRule
from modeling.formula.source import Source
from modeling.formula.tree import Call, Name, Node, Number, Power, Product, Sum
from modeling.units import NUMBER, Dimension

REMEDY = 'correct it, or give the constant its unit: constants = { x0 = "0.1 m" }'


def require_unit(tree: Node, units: Mapping[str, Dimension], expected: Dimension, source: Source) -> None:
    """Raise InputError unless the formula has the unit `expected` and is consistent in itself."""
    found = unit_of(tree, units, source)
    if found is not None and found != expected:
        what = f"its unit is {_said(found)}, and {_said(expected)} was expected"
        raise source.refusal(tree.column, what, REMEDY)


def unit_of(tree: Node, units: Mapping[str, Dimension], source: Source) -> Dimension | None:
    """The unit of a formula whose names have these units; None for a bare 0, which is one of anything.

    Other bare numbers are pure numbers.
    Raises InputError, naming the column, where terms of different units meet or a function is given a wrong one.
    """
    match tree:
        case Number(value=value):
            return NUMBER if value else None
        case Name(name=name):
            return units[name]
        case Sum(terms=terms):
            return _alike([child for _, child in terms], units, source)
        case Product(factors=factors):
            total = NUMBER
            for sign, child in factors:
                total *= (unit_of(child, units, source) or NUMBER) ** sign
            return total
        case Power(base=base, exponent=exponent):
            return (unit_of(base, units, source) or NUMBER) ** exponent
        case Call():
            return _of_call(tree, units, source)


def _of_call(call: Call, units: Mapping[str, Dimension], source: Source) -> Dimension | None:
    rule = call.function.rule
    if rule is UnitRule.SAME:
        return _alike(call.arguments, units, source)
    if rule is UnitRule.RATIO:
        _alike(call.arguments, units, source)
        return NUMBER
    (argument,) = call.arguments
    unit = unit_of(argument, units, source) or NUMBER
    if rule is UnitRule.ROOT:
        return unit ** Fraction(1, 2)
    if unit != NUMBER:
        what = f"{call.function.name} needs a pure number, and {_said(unit)} came"
        raise source.refusal(argument.column, what, "divide by a constant or parameter of that unit")
    return NUMBER


def _alike(parts: Sequence[Node], units: Mapping[str, Dimension], source: Source) -> Dimension | None:
    """The one unit that all parts have."""
    known: Dimension | None = None
    for part in parts:
        unit = unit_of(part, units, source)
        if known is not None and unit is not None and unit != known:
            raise source.refusal(part.column, f"{_said(unit)} meets {_said(known)} here", REMEDY)
        known = known if unit is None else unit
    return known


def _said(unit: Dimension) -> str:
    return "1 (a pure number)" if unit == NUMBER else str(unit)
