"""Number of arithmetic operations to evaluate an expression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import reduce
from operator import add
from typing import Self

from modeling import symbolic as sp


@dataclass(frozen=True, kw_only=True)
class OperationCount:
    """Numbers of additions and subtractions, multiplications, divisions and function calls."""

    sums: int = 0
    products: int = 0
    quotients: int = 0
    calls: int = 0

    def __add__(self, other: OperationCount) -> OperationCount:
        return OperationCount(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    @property
    def total(self) -> int:
        """Number of all operations."""
        return self.sums + self.products + self.quotients + self.calls

    @classmethod
    def sum(cls, parts: list[OperationCount]) -> Self:
        """Sum over all parts."""
        return reduce(add, parts, cls())

    def __str__(self) -> str:
        parts = f"{self.sums} + -, {self.products} *, {self.quotients} /, {self.calls} functions"
        return f"{self.total} ({parts})"


def count_operations(expression: sp.Expr, known: Mapping[sp.Symbol, OperationCount] | None = None) -> OperationCount:
    """Operations to evaluate an expression as generated code does; a symbol counts as in `known`, else zero.

    A sign counts zero, a quotient one whatever its factors; a power takes the products of exponentiation by squaring.
    """
    known = {} if known is None else known
    if expression.is_Symbol:
        return known.get(expression, OperationCount())
    if expression.is_number or isinstance(expression, sp.DiracDelta):
        return OperationCount()
    if expression.is_Mul and expression.as_coeff_Mul()[0].is_negative:
        return count_operations(-expression, known)
    own, parts = _own_operations(expression)
    return OperationCount.sum([own, *(count_operations(part, known) for part in parts)])


def _own_operations(expression: sp.Expr) -> tuple[OperationCount, Sequence[sp.Expr]]:
    """The operations on the parts of an expression, and these parts."""
    parts = expression.args
    if expression.is_Add:
        return OperationCount(sums=len(parts) - 1), parts
    if expression.is_Mul:
        below = [1 / factor for factor in parts if _is_inverse(factor)]
        above = [factor for factor in parts if not _is_inverse(factor)]
        products = max(len(above) - 1, 0) + max(len(below) - 1, 0)
        return OperationCount(products=products, quotients=bool(below)), [*above, *below]
    if _is_inverse(expression):
        return OperationCount(quotients=1), [1 / expression]
    if expression.is_Pow and expression.exp.is_Integer:
        digits = bin(int(expression.exp))[2:]
        return OperationCount(products=len(digits) - 1 + digits.count("1") - 1), [expression.base]
    if expression.is_Pow and expression.exp == sp.S.Half:
        return OperationCount(calls=1), [expression.base]
    if isinstance(expression, sp.Heaviside):
        return OperationCount(calls=1), parts[:1]
    pairwise = isinstance(expression, (sp.Max, sp.Min))
    return OperationCount(calls=len(parts) - 1 if pairwise else 1), parts


def _is_inverse(factor: sp.Expr) -> bool:
    """Whether it is a power with a negative exponent."""
    return bool(factor.is_Pow and factor.exp.is_Rational and factor.exp.is_negative)
