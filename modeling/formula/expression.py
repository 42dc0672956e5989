"""Expression: a formula's tree as SymPy, built operation by operation, never from text."""

from __future__ import annotations

from collections.abc import Mapping

from modeling import symbolic as sp
from modeling.formula.source import Source
from modeling.formula.tree import Call, Name, Node, Number, Power, Product, Sum

LARGEST_WHOLE = 1000
"""Whole numbers up to here stay whole, so that x/2 prints as it was written; larger ones multiply as floats."""
LARGEST = 1e300
"""Of a number that SymPy makes of others: floats end soon after."""


def expression(tree: Node, values: Mapping[str, sp.Expr], source: Source) -> sp.Expr:
    """The formula over the expressions of its names.

    Raises InputError, naming the column, where names cancel and leave no finite real number, as in 1/(x - x).
    """
    match tree:
        case Number(value=value):
            return sp.Integer(int(value)) if value == int(value) and abs(value) <= LARGEST_WHOLE else sp.Float(value)
        case Name(name=name):
            return values[name]
    try:
        built = _combined(tree, values, source)
    except (ValueError, TypeError):  # SymPy's comparisons refuse what is infinite or not real
        built = sp.nan
    strange = (sp.zoo, sp.nan, sp.oo, sp.S.NegativeInfinity, sp.I)
    if built.has(*strange) or not all(map(_is_plain, (built, *built.args))):
        raise source.refusal(tree.column, "this leaves no finite real number", "correct the formula there")
    return built


def _combined(tree: Node, values: Mapping[str, sp.Expr], source: Source) -> sp.Expr:
    match tree:
        case Sum(terms=terms):
            return sp.Add(*(sign * expression(child, values, source) for sign, child in terms))
        case Product(factors=factors):
            return sp.Mul(*(expression(child, values, source) ** sign for sign, child in factors))
        case Power(base=base, exponent=exponent):
            return expression(base, values, source) ** sp.Rational(exponent.numerator, exponent.denominator)
        case Call(function=function, arguments=arguments):
            built = function.expression(*(expression(child, values, source) for child in arguments))
            if built.is_number and built.is_finite is None:  # atan2(1, 0), as it stands, does not know
                return sp.Float(function.number(*map(float, built.args)))
            return built
        case _:
            raise TypeError(f"{type(tree).__name__} is no operation")


def _is_plain(part: sp.Expr) -> bool:
    """Whether a part is no number, or one that a float can hold."""
    if not part.is_number:
        return True
    return bool(part.is_finite and part.is_real and abs(part) < LARGEST)
