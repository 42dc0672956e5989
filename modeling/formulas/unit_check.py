"""Dimensional analysis of a formula's syntax tree; errors name the column."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from fractions import Fraction

from modeling.formulas.functions import FORMULA_FUNCTIONS, UnitRule
from modeling.formulas.syntax_tree import child_nodes, exponent, signed_parts
from modeling.formulas.tokens import FormulaSource
from modeling.formulas.units import DIMENSIONLESS, Dimension

UNIT_REMEDY = 'correct it, or give the constant its unit: constants = { x0 = "0.1 m" }'


def require_unit(tree: ast.expr, units: Mapping[str, Dimension], expected: Dimension, source: FormulaSource) -> None:
    """Raise InputError unless the formula has the unit `expected` and is consistent in itself."""
    found = unit_of(tree, units, source)
    if found is not None and found != expected:
        what = f"its unit is {_unit_text(found)}, expected {_unit_text(expected)}"
        raise source.error(tree.col_offset, what, UNIT_REMEDY)


def unit_of(tree: ast.expr, units: Mapping[str, Dimension], source: FormulaSource) -> Dimension | None:
    """The unit of a formula whose names have these units; None for a literal 0, which has any unit.

    Other literal numbers are dimensionless.
    Raises InputError, naming the column, for terms of different units or a function's argument of a wrong one.
    """
    match tree:
        case ast.Constant(value=value):
            return DIMENSIONLESS if value else None
        case ast.Name(id=name):
            return units[name]
        case ast.BinOp(op=ast.Pow()):
            return (unit_of(tree.left, units, source) or DIMENSIONLESS) ** exponent(tree)
        case ast.BinOp(op=ast.Mult() | ast.Div()):
            total = DIMENSIONLESS
            for sign, child in signed_parts(tree):
                total *= (unit_of(child, units, source) or DIMENSIONLESS) ** sign
            return total
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _of_call(name, arguments, units, source)
        case _:
            return _common_unit(child_nodes(tree), units, source)


def _of_call(
    name: str, arguments: Sequence[ast.expr], units: Mapping[str, Dimension], source: FormulaSource
) -> Dimension | None:
    rule = FORMULA_FUNCTIONS[name].rule
    if rule is UnitRule.SAME:
        return _common_unit(arguments, units, source)
    if rule is UnitRule.RATIO:
        _common_unit(arguments, units, source)
        return DIMENSIONLESS
    (argument,) = arguments
    unit = unit_of(argument, units, source) or DIMENSIONLESS
    if rule is UnitRule.ROOT:
        return unit ** Fraction(1, 2)
    if unit != DIMENSIONLESS:
        what = f"{name} needs a dimensionless argument, got {_unit_text(unit)}"
        raise source.error(argument.col_offset, what, "divide by a constant or parameter of that unit")
    return DIMENSIONLESS


def _common_unit(parts: Sequence[ast.expr], units: Mapping[str, Dimension], source: FormulaSource) -> Dimension | None:
    """The common unit of all parts."""
    known: Dimension | None = None
    for part in parts:
        unit = unit_of(part, units, source)
        if known is not None and unit is not None and unit != known:
            what = f"incompatible units {_unit_text(unit)} and {_unit_text(known)}"
            raise source.error(part.col_offset, what, UNIT_REMEDY)
        known = known if unit is None else unit
    return known


def _unit_text(unit: Dimension) -> str:
    return "1 (dimensionless)" if unit == DIMENSIONLESS else str(unit)
