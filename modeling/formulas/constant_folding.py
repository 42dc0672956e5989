"""Syntax-tree operations with constants evaluated."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from fractions import Fraction

from modeling.formulas.functions import FormulaFunction
from modeling.formulas.source import FormulaSource
from modeling.formulas.syntax_tree import Call, Node, Number, Power, Product, Sum

LARGEST_EXPONENT = 8
"""Bound on numerator and denominator of an exponent: no law of physics has more, and 9^9^9 would never end."""
FRACTION_TOLERANCE = 1e-12
"""Tolerance within which a float is taken for a fraction."""

SignedTerms = tuple[tuple[int, Node], ...]


def folded_number(source: FormulaSource, compute: Callable[[], float], column: int) -> Number:
    """The value of `compute`, in floats, as integers could grow without bound.

    Raises InputError, naming the column, when it is undefined or not finite.
    """
    try:
        value = compute()
    except ZeroDivisionError:
        raise source.error(column, "division by zero", "correct the numbers there") from None
    except (ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise source.error(column, "the value is not a finite number", "correct the numbers there")
    return Number(value, column)


def folded_sum(source: FormulaSource, terms: SignedTerms, column: int) -> Node:
    """The sum of terms, each with its sign."""
    values = _values(child for _, child in terms)
    if values is None:
        return Sum(terms, column)
    return folded_number(source, lambda: sum(s * v for (s, _), v in zip(terms, values, strict=True)), column)


def folded_product(source: FormulaSource, factors: SignedTerms, column: int) -> Node:
    """The product of factors, those with sign -1 as divisors."""
    values = _values(child for _, child in factors)
    if values is None:
        return Product(factors, column)
    pairs = [(sign, value) for (sign, _), value in zip(factors, values, strict=True)]
    return folded_number(source, lambda: math.prod(v if s > 0 else 1 / v for s, v in pairs), column)


def folded_power(source: FormulaSource, base: Node, exponent: Node, column: int, at: int) -> Node:
    """A power with a small constant exponent; `at` is the column of the exponent."""
    power = _exponent(source, exponent, at)
    if not isinstance(base, Number):
        return Power(base, power, column)
    return folded_number(source, lambda: _real_power(base.value, power), column)


def folded_call(source: FormulaSource, function: FormulaFunction, arguments: tuple[Node, ...], column: int) -> Node:
    """A function call."""
    values = _values(arguments)
    if values is None:
        return Call(function, arguments, column)
    return folded_number(source, lambda: function.number(*values), column)


def _values(parts: Iterable[Node]) -> list[float] | None:
    """The values of the parts when all are numbers, else None."""
    values = []
    for part in parts:
        if not isinstance(part, Number):
            return None
        values.append(part.value)
    return values


def _exponent(source: FormulaSource, exponent: Node, at: int) -> Fraction:
    remedy = f"use a constant such as 2, -3 or 1/2 of numbers up to {LARGEST_EXPONENT}, and exp(x) for other powers"
    if not isinstance(exponent, Number):
        raise source.error(at, "the exponent is not a constant", remedy)
    if abs(exponent.value) <= LARGEST_EXPONENT:
        power = Fraction(exponent.value).limit_denominator(LARGEST_EXPONENT)
        if abs(power.numerator) <= LARGEST_EXPONENT and abs(float(power) - exponent.value) < FRACTION_TOLERANCE:
            return power
    raise source.error(at, f"the exponent {exponent.value:.6g} is out of range", remedy)


def _real_power(base: float, power: Fraction) -> float:
    if base < 0 and power.denominator > 1:
        raise ValueError("a root of a negative number is not real")
    return float(base ** (int(power) if power.denominator == 1 else float(power)))
