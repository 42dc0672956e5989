"""SymPy expression of a formula's syntax tree, built node by node, never from text."""

from __future__ import annotations

from collections.abc import Mapping

from modeling import symbolic as sp
from modeling.formulas.source import FormulaSource
from modeling.formulas.syntax_tree import Call, Name, Node, Number, Power, Product, Sum

LARGEST_INTEGER = 1000
"""Integers up to this stay integers, so that x/2 prints as written; larger ones become floats."""
LARGEST_FLOAT = 1e300
"""Bound on numbers that SymPy computes, near the largest float."""


def to_sympy(tree: Node, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    """The formula with expressions for its names.

    Raises InputError, naming the column, where it simplifies to no finite real number, as in 1/(x - x).
    """
    match tree:
        case Number(value=value):
            return sp.Integer(int(value)) if value == int(value) and abs(value) <= LARGEST_INTEGER else sp.Float(value)
        case Name(name=name):
            return values[name]
    try:
        built = _combined(tree, values, source)
    except (ValueError, TypeError):  # SymPy cannot compare infinite or complex values
        built = sp.nan
    invalid = (sp.zoo, sp.nan, sp.oo, sp.S.NegativeInfinity, sp.I)
    if built.has(*invalid) or not all(map(_is_representable, (built, *built.args))):
        raise source.error(tree.column, "it simplifies to no finite real number", "correct the formula there")
    return built


def _combined(tree: Node, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    match tree:
        case Sum(terms=terms):
            return sp.Add(*(sign * to_sympy(child, values, source) for sign, child in terms))
        case Product(factors=factors):
            return sp.Mul(*(to_sympy(child, values, source) ** sign for sign, child in factors))
        case Power(base=base, exponent=exponent):
            return to_sympy(base, values, source) ** sp.Rational(exponent.numerator, exponent.denominator)
        case Call(function=function, arguments=arguments):
            built = function.expression(*(to_sympy(child, values, source) for child in arguments))
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
