"""Operations: how much arithmetic an expression takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import reduce
from operator import add
from typing import Self

from modeling import symbolic as sp
from modeling.emit.arithmetic import Arithmetic


@dataclass(frozen=True, kw_only=True)
class Operations:
    """Numbers of additions and subtractions, of multiplications, divisions and calls of functions."""

    sums: int = 0
    products: int = 0
    quotients: int = 0
    calls: int = 0

    def __add__(self, other: Operations) -> Operations:
        return Operations(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    @property
    def total(self) -> int:
        """All of them."""
        return self.sums + self.products + self.quotients + self.calls

    @classmethod
    def sum(cls, parts: list[Operations]) -> Self:
        """All parts together."""
        return reduce(add, parts, cls())

    def __str__(self) -> str:
        parts = f"{self.sums} + -, {self.products} *, {self.quotients} /, {self.calls} functions"
        return f"{self.total} ({parts})"


@dataclass(frozen=True)
class Counting(Arithmetic[Operations]):
    """What it takes to evaluate an expression; a symbol costs what `known` says, else nothing. A sign is free."""

    known: Mapping[sp.Symbol, Operations] = field(default_factory=dict)

    def number(self, value: float) -> Operations:
        """Nothing."""
        return Operations()

    def symbol(self, symbol: sp.Symbol) -> Operations:
        """What is known of it."""
        return self.known.get(symbol, Operations())

    def add(self, left: Operations, right: Operations) -> Operations:
        """One sum more."""
        return left + right + Operations(sums=1)

    def subtract(self, left: Operations, right: Operations) -> Operations:
        """One sum more."""
        return self.add(left, right)

    def multiply(self, left: Operations, right: Operations) -> Operations:
        """One product more."""
        return left + right + Operations(products=1)

    def divide(self, left: Operations, right: Operations) -> Operations:
        """One quotient more."""
        return left + right + Operations(quotients=1)

    def negate(self, value: Operations) -> Operations:
        """Nothing more."""
        return value

    def power(self, base: Operations, exponent: int) -> Operations:
        """Squares of squares, and a product for each further binary digit."""
        digits = bin(exponent)[2:]
        return base + Operations(products=len(digits) - 1 + digits.count("1") - 1)

    def call(self, name: str, *arguments: Operations) -> Operations:
        """One call more."""
        return Operations.sum([*arguments, Operations(calls=1)])
