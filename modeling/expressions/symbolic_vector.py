"""A vector of SymPy expressions with its inputs, parameters and intermediate variables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from modeling import symbolic as sp
from modeling.expressions.compilation import casadi_results, common_subexpressions
from modeling.expressions.intermediate_variables import Definitions, required_definitions, symbols_of
from modeling.expressions.straight_line_program import StraightLineProgram


@dataclass(frozen=True, eq=False)
class SymbolicVector:
    """SymPy expressions (p,) of inputs, parameters and intermediate variables, defined in order."""

    expression: sp.Matrix
    inputs: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    definitions: Definitions = ()

    def graph(self, u: Any, theta: Any) -> Any:
        """As a dense CasADi vector over CasADi vectors u (m,) and theta (k,)."""
        import casadi as ca

        known: dict[sp.Symbol, Any] = {sp.Symbol(n, real=True): u[i] for i, n in enumerate(self.inputs)}
        known |= {symbol: theta[i] for i, symbol in enumerate(self.parameters)}
        replacements, reduced = common_subexpressions(list(self.expression))
        steps = (*required_definitions(self.definitions, self.expression), *replacements)
        results = casadi_results(StraightLineProgram(steps, tuple(reduced)), known)
        return ca.densify(ca.vertcat(ca.SX(0, 1), *results))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names."""
        return tuple(symbol.name for symbol in self.parameters)

    @cached_property
    def active(self) -> tuple[int, ...]:
        """Indices of the parameters that it depends on."""
        free = symbols_of(self.definitions, self.expression)
        return tuple(i for i, symbol in enumerate(self.parameters) if symbol in free)
