"""SymPy expression of a formula's syntax tree, built node by node, never from text."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from modeling import symbolic as sp
from modeling.formulas.functions import FORMULA_FUNCTIONS
from modeling.formulas.syntax_tree import exponent, signed_parts
from modeling.formulas.tokens import FormulaSource

LARGEST_INTEGER = 1000
"""Integers up to this stay integers, so that x/2 prints as written; larger ones become floats."""
LARGEST_FLOAT = 1e300
"""Bound on numbers that SymPy computes, near the largest float."""


def to_sympy(tree: ast.expr, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    """The formula with expressions for its names.

    Raises InputError, naming the column, where it simplifies to no finite real number, as in 1/(x - x).
    """
    match tree:
        case ast.Constant(value=float(value)):
            return sp.Integer(int(value)) if value == int(value) and abs(value) <= LARGEST_INTEGER else sp.Float(value)
        case ast.Name(id=name):
            return values[name]
    try:
        built = _combined(tree, values, source)
        if not built.has(*_NOT_FINITE) and all(map(_is_representable, (built, *built.args))):
            return built
    except (ValueError, TypeError):
        pass  # SymPy cannot compare infinite or complex values
    raise source.error(tree.col_offset, "it simplifies to no finite real number", "correct the formula there")


_NOT_FINITE = (sp.zoo, sp.nan, sp.oo, sp.S.NegativeInfinity, sp.I)


def _combined(tree: ast.expr, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    match tree:
        case ast.UnaryOp():
            return -to_sympy(tree.operand, values, source)
        case ast.BinOp(op=ast.Pow()):
            power = exponent(tree)
            return to_sympy(tree.left, values, source) ** sp.Rational(power.numerator, power.denominator)
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return sp.Add(*(sign * to_sympy(child, values, source) for sign, child in signed_parts(tree)))
        case ast.BinOp():
            return sp.Mul(*(to_sympy(child, values, source) ** sign for sign, child in signed_parts(tree)))
        case ast.Call(func=ast.Name(id=name)):
            function = FORMULA_FUNCTIONS[name]
            built = function.expression(*(to_sympy(child, values, source) for child in tree.args))
            if built.is_number and built.is_finite is None:  # atan2(1, 0) unevaluated
                return sp.Float(function.number(*map(float, built.args)))
            return built
        case _:
            raise TypeError(f"{type(tree).__name__} is not an operation")


def _is_representable(part: sp.Expr) -> bool:
    """Whether a part is not a number, or is a number within the range of floats."""
    if not part.is_number:
        return True
    return bool(part.is_finite and part.is_real and abs(part) < LARGEST_FLOAT)
