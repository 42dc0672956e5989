"""A vector of SymPy expressions with its inputs, parameters and intermediate variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from operator import add, mul
from typing import Any

import casadi as ca

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import Definitions, StraightLineProgram, required_definitions, symbols_of
from modeling.errors import InputError

FUNCTIONS = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sign")
"""Elementary functions whose name is the same in SymPy and CasADi, and in C but for `sign`."""


def common_subexpressions(expressions: Sequence[sp.Expr]) -> tuple[Definitions, list[sp.Expr]]:
    """Common subexpressions `(symbol, expression)` in order, and the expressions written with them."""
    replacements, reduced = sp.cse(list(expressions), symbols=sp.numbered_symbols("shared_", real=True), order="none")
    return tuple(replacements), list(reduced)


def numpy_function(inputs: Sequence[sp.Symbol], expressions: Sequence[sp.Expr]) -> Callable[..., list[Any]]:
    """A NumPy function of the inputs (arrays that broadcast) returning the list of values of the expressions.

    The expressions are derivations, or built node by node from users' formulas: never text.
    """
    return _numpy_function(tuple(inputs), tuple(expressions))


@lru_cache(maxsize=256)
def _numpy_function(inputs: tuple[sp.Symbol, ...], expressions: tuple[sp.Expr, ...]) -> Callable[..., list[Any]]:
    steps, reduced = common_subexpressions(expressions)
    function: Callable[..., list[Any]] = sp.lambdify(
        list(inputs), reduced, modules="numpy", cse=lambda results: (steps, results)
    )
    return function


def casadi_expressions(values: Mapping[sp.Symbol, Any], expressions: Sequence[sp.Expr]) -> list[Any]:
    """The expressions as CasADi graphs, given the graphs of their symbols, common subexpressions shared."""
    steps, reduced = common_subexpressions(expressions)
    return casadi_results(StraightLineProgram(steps, tuple(reduced)), values)


def casadi_results(program: StraightLineProgram, values: Mapping[sp.Symbol, Any]) -> list[Any]:
    """The results of a program as CasADi graphs, given the graphs of its inputs.

    Raises InputError for a function without counterpart in CasADi.
    """
    graphs = dict(values)
    for symbol, expression in program.steps:
        graphs[symbol] = _casadi_expression(graphs, expression)
    return [_casadi_expression(graphs, result) for result in program.results]


def _casadi_expression(graphs: Mapping[sp.Symbol, Any], expression: sp.Expr) -> Any:
    """One expression as a CasADi graph, node by node."""
    if isinstance(expression, sp.Symbol):
        return graphs[expression]
    if expression.is_number:
        return ca.DM(float(expression))
    operation = _casadi_operations().get(expression.func)
    if operation is None:
        what = f"the function {expression.func} has no counterpart in generated code"
        raise InputError(what=what, where="model", remedy="leave the effect out")
    return operation(*(_casadi_expression(graphs, argument) for argument in expression.args))


@lru_cache(maxsize=1)
def _casadi_operations() -> dict[Any, Callable[..., Any]]:
    return {
        sp.Add: lambda *terms: reduce(add, terms),
        sp.Mul: lambda *factors: reduce(mul, factors),
        sp.Pow: lambda base, exponent: base**exponent,
        sp.Abs: ca.fabs,
        sp.Max: lambda *arguments: reduce(ca.fmax, arguments),
        sp.Min: lambda *arguments: reduce(ca.fmin, arguments),
        sp.Heaviside: lambda x, _: 0.5 * (1 + ca.sign(x)),
        sp.DiracDelta: lambda x: ca.DM(0.0),  # the derivative of a step: zero everywhere but at the step
        **{getattr(sp, name): getattr(ca, name) for name in FUNCTIONS},
    }


@dataclass(frozen=True, eq=False)
class SymbolicVector:
    """SymPy expressions (p,) of inputs, parameters and intermediate variables, defined in order."""

    expression: sp.Matrix
    inputs: tuple[str, ...]
    parameters: tuple[sp.Symbol, ...]
    definitions: Definitions = ()

    def graph(self, u: Any, theta: Any) -> Any:
        """As a dense CasADi vector over CasADi vectors u (m,) and theta (k,)."""
        graphs: dict[sp.Symbol, Any] = {sp.Symbol(n, real=True): u[i] for i, n in enumerate(self.inputs)}
        graphs |= {symbol: theta[i] for i, symbol in enumerate(self.parameters)}
        replacements, reduced = common_subexpressions(list(self.expression))
        steps = (*required_definitions(self.definitions, self.expression), *replacements)
        results = casadi_results(StraightLineProgram(steps, tuple(reduced)), graphs)
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
