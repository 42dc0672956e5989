"""Steps: a derivation written one named step after another, with rates in time by the chain rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from modeling import symbolic as sp

Definitions: TypeAlias = "tuple[tuple[sp.Symbol, sp.Expr], ...]"


class Steps:
    """Named expressions in the order in which they can be evaluated, each of inputs and of steps before it.

    `moving` says what the rate of each input is: q1 -> dq1, dq1 -> ddq1. Whatever it does not name stays as it is.
    With `named` False nothing is given a name, and expressions stay whole: for small ones that people read.
    """

    def __init__(self, moving: Mapping[sp.Symbol, sp.Expr], *, named: bool = True, prefix: str = "step_") -> None:
        self._named, self._prefix = named, prefix
        self._steps: dict[sp.Symbol, sp.Expr] = {}
        self._names: dict[sp.Expr, sp.Symbol] = {}
        self._rates: dict[sp.Symbol, sp.Expr] = dict(moving)

    @property
    def definitions(self) -> Definitions:
        """The steps so far, in order."""
        return tuple(self._steps.items())

    def let(self, expression: sp.Expr) -> sp.Expr:
        """The expression under a name of its own; numbers and symbols are left alone."""
        expression = sp.sympify(expression)
        if not self._named or expression.is_Atom:
            return expression
        if expression not in self._names:
            name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
            self._steps[name], self._names[expression] = expression, name
        return self._names[expression]

    def held(self, expression: sp.Expr) -> sp.Expr:
        """The expression under a name, and taken for constant in time."""
        name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
        self._steps[name], self._rates[name] = expression, sp.S.Zero
        return name

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """The derivative in time: of an expression e(x, y, ..) it is de/dx dx/dt + de/dy dy/dt + .."""
        return self.let(self._slope(expression))

    def _slope(self, expression: sp.Expr) -> sp.Expr:
        if expression.is_Symbol:
            return self._rate_of(expression)
        if expression.is_Add:
            return sp.Add(*map(self._slope, expression.args))
        if expression.is_Mul:
            factors = expression.args
            slopes = map(self._slope, factors)
            return sp.Add(*(s * sp.Mul(*factors[:i], *factors[i + 1 :]) for i, s in enumerate(slopes) if s != 0))
        moved = sorted(expression.free_symbols, key=lambda symbol: symbol.name)
        return sp.Add(*(expression.diff(symbol) * self._rate_of(symbol) for symbol in moved))

    def _rate_of(self, symbol: sp.Symbol) -> sp.Expr:
        if symbol not in self._rates:
            known = symbol in self._steps
            self._rates[symbol] = self.rate(self._steps[symbol]) if known else sp.S.Zero
        return self._rates[symbol]


def needed(definitions: Definitions, expressions: sp.Matrix) -> Definitions:
    """The steps that the expressions are made of, in their order."""
    wanted = set(expressions.free_symbols)
    kept = []
    for symbol, expression in reversed(definitions):
        if symbol in wanted:
            wanted |= expression.free_symbols
            kept.append((symbol, expression))
    return tuple(reversed(kept))
