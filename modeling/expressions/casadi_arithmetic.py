"""SymPy expressions and straight-line programs as CasADi graphs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from modeling import symbolic as sp
from modeling.expressions.arithmetic import Arithmetic
from modeling.expressions.straight_line_program import StraightLineProgram


@dataclass(frozen=True)
class CasadiArithmetic(Arithmetic[Any]):
    """Expressions as CasADi graphs; `values` are the graphs of symbols."""

    values: Mapping[sp.Symbol, Any]

    def number(self, value: float) -> Any:
        """A constant."""
        import casadi as ca

        return ca.SX(value)

    def symbol(self, symbol: sp.Symbol) -> Any:
        """The graph of the symbol."""
        return self.values[symbol]

    def add(self, left: Any, right: Any) -> Any:
        """left + right."""
        return left + right

    def subtract(self, left: Any, right: Any) -> Any:
        """left - right."""
        return left - right

    def multiply(self, left: Any, right: Any) -> Any:
        """left * right."""
        return left * right

    def divide(self, left: Any, right: Any) -> Any:
        """left / right."""
        return left / right

    def negate(self, value: Any) -> Any:
        """-value."""
        return -value

    def power(self, base: Any, exponent: int) -> Any:
        """base * base * .."""
        product = base
        for _ in range(exponent - 1):
            product = product * base
        return product

    def call(self, name: str, *arguments: Any) -> Any:
        """A function, by C's name as in CasADi."""
        import casadi as ca

        if name == "step":
            return 0.5 * (1 + ca.sign(*arguments))
        return getattr(ca, "power" if name == "pow" else name)(*arguments)


def casadi_results(program: StraightLineProgram, values: Mapping[sp.Symbol, Any]) -> list[Any]:
    """The results of a program as CasADi graphs, given the graphs of its inputs."""
    known = dict(values)
    for symbol, expression in program.steps:
        known[symbol] = CasadiArithmetic(known).of(expression)
    return [CasadiArithmetic(known).of(result) for result in program.results]
