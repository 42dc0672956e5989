"""SymPy expressions compiled to NumPy functions and CasADi graphs, common subexpressions shared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from modeling import symbolic as sp


def common_subexpressions(expressions: Sequence[sp.Expr]) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Expr]]:
    """Common subexpressions `(symbol, expression)` in order, and the expressions written with them."""
    replacements, reduced = sp.cse(list(expressions), symbols=sp.numbered_symbols("shared_", real=True), order="none")
    return replacements, list(reduced)


def numpy_function(inputs: Sequence[sp.Symbol], expressions: Sequence[sp.Expr]) -> Callable[..., list[Any]]:
    """A NumPy function of the inputs (arrays that broadcast) returning the list of values of the expressions.

    The expressions are derivations, or built node by node from users' formulas: never text.
    """
    return _numpy_function(tuple(inputs), tuple(expressions))


@lru_cache(maxsize=256)
def _numpy_function(inputs: tuple[sp.Symbol, ...], expressions: tuple[sp.Expr, ...]) -> Callable[..., list[Any]]:
    function: Callable[..., list[Any]] = sp.lambdify(list(inputs), list(expressions), modules="numpy", cse=True)
    return function


def casadi_expressions(values: dict[sp.Symbol, Any], expressions: Sequence[sp.Expr]) -> list[Any]:
    """The expressions as CasADi graphs over the given CasADi values of their symbols, common subexpressions shared."""
    replacements, reduced = common_subexpressions(expressions)
    known = dict(values)
    for symbol, expression in replacements:
        known[symbol] = casadi_expression(known, expression)
    return [casadi_expression(known, expression) for expression in reduced]


def casadi_expression(known: dict[sp.Symbol, Any], expression: sp.Expr) -> Any:
    """One expression as a CasADi graph, node by node; a node without counterpart in CasADi is a KeyError."""
    import casadi as ca

    if isinstance(expression, sp.Symbol):
        return known[expression]
    if expression.is_number:
        return ca.DM(float(expression))
    arguments = [casadi_expression(known, a) for a in expression.args]
    return _casadi_operations(ca)[expression.func](*arguments)


def _casadi_operations(ca: Any) -> dict[Any, Callable[..., Any]]:
    from functools import reduce
    from operator import add, mul

    def power(base: Any, exponent: Any) -> Any:
        return base**exponent

    return {
        sp.Add: lambda *a: reduce(add, a),
        sp.Mul: lambda *a: reduce(mul, a),
        sp.Pow: power,
        sp.sin: ca.sin,
        sp.cos: ca.cos,
        sp.tan: ca.tan,
        sp.exp: ca.exp,
        sp.tanh: ca.tanh,
        sp.Abs: ca.fabs,
        sp.Max: lambda *a: reduce(ca.fmax, a),
        sp.Min: lambda *a: reduce(ca.fmin, a),
        sp.atan: ca.atan,
        sp.atan2: ca.atan2,
    }
