"""Constants: operations on tree nodes that are evaluated at once where all operands are numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from fractions import Fraction

from modeling.formula.functions import Function
from modeling.formula.source import Source
from modeling.formula.tree import Call, Node, Number, Power, Product, Sum

LARGEST_EXPONENT = 8
"""Numerator and denominator of a power: no law of physics has more, and 9^9^9 would never be done."""
ROUNDING = 1e-12
"""By which 1/3, as a float, may differ from a third."""

Signed = tuple[tuple[int, Node], ...]


def number(source: Source, compute: Callable[[], float], column: int) -> Number:
    """The number that `compute` gives, in floats, never in whole numbers that grow.

    Raises InputError, naming the column, when there is none or it is not finite.
    """
    try:
        value = compute()
    except ZeroDivisionError:
        raise source.refusal(column, "it divides by zero", "correct the numbers there") from None
    except (ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise source.refusal(column, "this is no finite number", "correct the numbers there")
    return Number(value, column)


def added(source: Source, terms: Signed, column: int) -> Node:
    """The sum of terms, each with its sign."""
    values = _values(child for _, child in terms)
    if values is None:
        return Sum(terms, column)
    return number(source, lambda: sum(s * v for (s, _), v in zip(terms, values, strict=True)), column)


def multiplied(source: Source, factors: Signed, column: int) -> Node:
    """The product of factors, those with -1 divided by."""
    values = _values(child for _, child in factors)
    if values is None:
        return Product(factors, column)
    pairs = [(sign, value) for (sign, _), value in zip(factors, values, strict=True)]
    return number(source, lambda: math.prod(v if s > 0 else 1 / v for s, v in pairs), column)


def raised(source: Source, base: Node, exponent: Node, column: int, at: int) -> Node:
    """The base to a power that is a small constant; `at` is the column of the exponent."""
    power = _exponent(source, exponent, at)
    if not isinstance(base, Number):
        return Power(base, power, column)
    return number(source, lambda: _real_power(base.value, power), column)


def applied(source: Source, function: Function, arguments: tuple[Node, ...], column: int) -> Node:
    """The function of its arguments."""
    values = _values(arguments)
    if values is None:
        return Call(function, arguments, column)
    return number(source, lambda: function.number(*values), column)


def _values(parts: Iterable[Node]) -> list[float] | None:
    """The numbers, when all parts are numbers."""
    values = []
    for part in parts:
        if not isinstance(part, Number):
            return None
        values.append(part.value)
    return values


def _exponent(source: Source, exponent: Node, at: int) -> Fraction:
    remedy = f"use a constant such as 2, -3 or 1/2 of numbers up to {LARGEST_EXPONENT}, and exp(x) for other powers"
    if not isinstance(exponent, Number):
        raise source.refusal(at, "the power is not a constant", remedy)
    if abs(exponent.value) <= LARGEST_EXPONENT:
        power = Fraction(exponent.value).limit_denominator(LARGEST_EXPONENT)
        if abs(power.numerator) <= LARGEST_EXPONENT and abs(float(power) - exponent.value) < ROUNDING:
            return power
    raise source.refusal(at, f"the power {exponent.value:.6g} is out of range", remedy)


def _real_power(base: float, power: Fraction) -> float:
    if base < 0 and power.denominator > 1:
        raise ValueError("a root of a negative number is not real")
    return float(base ** (int(power) if power.denominator == 1 else float(power)))
