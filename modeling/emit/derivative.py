"""Derivative of a program, step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from modeling import symbolic as sp
from modeling.emit.program import Program


def derivative(program: Program, symbols: Sequence[sp.Symbol]) -> Program:
    """The program of d result_i / d symbol_j, result by result.

    By the chain rule, forwards: of a step e(x, .., theta) it is the partial derivative in theta and, over all steps x
    before it, de/dx dx/dtheta.
    """
    steps, results = [(s, Slopes(e)) for s, e in program.steps], [Slopes(e) for e in program.results]
    found, columns = list(program.steps), []
    for number, symbol in enumerate(symbols):
        known: dict[sp.Symbol, sp.Expr] = {symbol: sp.S.One}
        for step, slopes in steps:
            rate = slopes.along(known)
            if rate != 0:
                known[step] = sp.Symbol(f"rate_{number}_{step.name}", real=True)
                found.append((known[step], rate))
        columns.append([slopes.along(known) for slopes in results])
    return Program.of([column[i] for i in range(len(results)) for column in columns], tuple(found))


@dataclass(frozen=True, eq=False)
class Slopes:
    """The partial derivatives of an expression, each taken when it is first asked for."""

    expression: sp.Expr

    @cached_property
    def _by(self) -> dict[sp.Symbol, sp.Expr | None]:
        return dict.fromkeys(sorted(self.expression.free_symbols, key=lambda s: str(s.name)))

    def along(self, known: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
        """The derivative along a direction, in which the symbols change as `known` says and the others not at all."""
        total = sp.S.Zero
        for symbol in self._by:
            if symbol in known:
                total += self._partial(symbol) * known[symbol]
        return total

    def _partial(self, symbol: sp.Symbol) -> sp.Expr:
        slope = self._by[symbol]
        if slope is None:
            slope = self._by[symbol] = self.expression.diff(symbol)
        return slope
