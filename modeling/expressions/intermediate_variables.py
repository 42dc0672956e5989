"""Derivations as a sequence of named intermediate variables, differentiated in time by the chain rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from modeling import symbolic as sp

Definitions: TypeAlias = "tuple[tuple[sp.Symbol, sp.Expr], ...]"


class IntermediateVariables:
    """Intermediate variables in order of evaluation, each a function of inputs and of earlier variables.

    `moving` maps inputs to their time derivatives: q1 -> dq1, dq1 -> ddq1; other inputs are constant in time.
    With `named` False no variables are introduced and expressions stay whole: for short ones meant to be read.
    """

    def __init__(self, moving: Mapping[sp.Symbol, sp.Expr], *, named: bool = True, prefix: str = "step_") -> None:
        self._named, self._prefix = named, prefix
        self._steps: dict[sp.Symbol, sp.Expr] = {}
        self._names: dict[sp.Expr, sp.Symbol] = {}
        self._rates: dict[sp.Symbol, sp.Expr] = dict(moving)

    @property
    def definitions(self) -> Definitions:
        """The intermediate variables so far, in order."""
        return tuple(self._steps.items())

    def let(self, expression: sp.Expr) -> sp.Expr:
        """A new intermediate variable for the expression; numbers and symbols are returned as they are."""
        expression = sp.sympify(expression)
        if not self._named or expression.is_Atom:
            return expression
        if expression not in self._names:
            name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
            self._steps[name], self._names[expression] = expression, name
        return self._names[expression]

    def held(self, expression: sp.Expr) -> sp.Expr:
        """A new intermediate variable for the expression, constant in time."""
        name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
        self._steps[name], self._rates[name] = expression, sp.S.Zero
        return name

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """The time derivative of e(x, y, ..): de/dx dx/dt + de/dy dy/dt + .."""
        return self.let(self._derivative(expression))

    def _derivative(self, expression: sp.Expr) -> sp.Expr:
        if expression.is_Symbol:
            return self._rate_of(expression)
        if expression.is_Add:
            return sp.Add(*map(self._derivative, expression.args))
        if expression.is_Mul:
            factors = expression.args
            derivatives = map(self._derivative, factors)
            return sp.Add(*(d * sp.Mul(*factors[:i], *factors[i + 1 :]) for i, d in enumerate(derivatives) if d != 0))
        symbols = sorted(expression.free_symbols, key=lambda symbol: symbol.name)
        return sp.Add(*(expression.diff(symbol) * self._rate_of(symbol) for symbol in symbols))

    def _rate_of(self, symbol: sp.Symbol) -> sp.Expr:
        if symbol not in self._rates:
            defined = symbol in self._steps
            self._rates[symbol] = self.rate(self._steps[symbol]) if defined else sp.S.Zero
        return self._rates[symbol]


def symbols_of(definitions: Definitions, expressions: sp.Matrix) -> set[sp.Symbol]:
    """The symbols of the expressions, and of the definitions that they depend on."""
    found = set(expressions.free_symbols)
    for symbol, expression in reversed(definitions):
        if symbol in found:
            found |= expression.free_symbols
    return found


def required_definitions(definitions: Definitions, expressions: sp.Matrix) -> Definitions:
    """The definitions that the expressions depend on, in order."""
    required = symbols_of(definitions, expressions)
    return tuple((symbol, expression) for symbol, expression in definitions if symbol in required)
