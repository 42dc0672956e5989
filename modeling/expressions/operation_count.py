"""Number of arithmetic operations to evaluate an expression."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import reduce
from operator import add
from typing import Self

from modeling import symbolic as sp
from modeling.expressions.arithmetic import Arithmetic


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


@dataclass(frozen=True)
class OperationCounter(Arithmetic[OperationCount]):
    """Operations to evaluate an expression; a symbol counts as in `known`, else zero. A sign counts zero."""

    known: Mapping[sp.Symbol, OperationCount] = field(default_factory=dict)

    def number(self, value: float) -> OperationCount:
        """Zero."""
        return OperationCount()

    def symbol(self, symbol: sp.Symbol) -> OperationCount:
        """Its operations in `known`."""
        return self.known.get(symbol, OperationCount())

    def add(self, left: OperationCount, right: OperationCount) -> OperationCount:
        """One sum more."""
        return left + right + OperationCount(sums=1)

    def subtract(self, left: OperationCount, right: OperationCount) -> OperationCount:
        """One sum more."""
        return self.add(left, right)

    def multiply(self, left: OperationCount, right: OperationCount) -> OperationCount:
        """One product more."""
        return left + right + OperationCount(products=1)

    def divide(self, left: OperationCount, right: OperationCount) -> OperationCount:
        """One quotient more."""
        return left + right + OperationCount(quotients=1)

    def negate(self, value: OperationCount) -> OperationCount:
        """No further operation."""
        return value

    def power(self, base: OperationCount, exponent: int) -> OperationCount:
        """Products of exponentiation by squaring."""
        digits = bin(exponent)[2:]
        return base + OperationCount(products=len(digits) - 1 + digits.count("1") - 1)

    def call(self, name: str, *arguments: OperationCount) -> OperationCount:
        """One call more."""
        return OperationCount.sum([*arguments, OperationCount(calls=1)])
