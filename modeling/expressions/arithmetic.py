"""Abstract arithmetic into which a SymPy expression is translated: text, operation count, CasADi graph, program."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import reduce
from typing import Generic, TypeVar

from modeling import symbolic as sp
from modeling.errors import InputError

T = TypeVar("T")

ELEMENTARY_FUNCTIONS: dict[str, str] = {
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "asin": "asin",
    "acos": "acos",
    "atan": "atan",
    "atan2": "atan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "Abs": "fabs",
    "sign": "sign",
    "Heaviside": "step",
}
"""SymPy's functions by name, and their names in an arithmetic: C's, where C has it."""

VARIADIC_FUNCTIONS = {"Max": "fmax", "Min": "fmin"}
"""Functions of any number of arguments, applied pairwise."""


class Arithmetic(ABC, Generic[T]):
    """Operations on values of type T; subtraction, division and powers are separate operations, as on a machine."""

    @abstractmethod
    def number(self, value: float) -> T:
        """A constant."""

    @abstractmethod
    def symbol(self, symbol: sp.Symbol) -> T:
        """An input, a parameter, or an intermediate variable evaluated before."""

    @abstractmethod
    def add(self, left: T, right: T) -> T:
        """left + right."""

    @abstractmethod
    def subtract(self, left: T, right: T) -> T:
        """left - right."""

    @abstractmethod
    def multiply(self, left: T, right: T) -> T:
        """left * right."""

    @abstractmethod
    def divide(self, left: T, right: T) -> T:
        """left / right."""

    @abstractmethod
    def negate(self, value: T) -> T:
        """-value."""

    @abstractmethod
    def power(self, base: T, exponent: int) -> T:
        """base**exponent, an integer of two or more."""

    @abstractmethod
    def call(self, name: str, *arguments: T) -> T:
        """A function by its name in ELEMENTARY_FUNCTIONS and VARIADIC_FUNCTIONS, `sqrt` or `pow`."""

    def of(self, expression: sp.Expr) -> T:
        """The expression in this arithmetic.

        Raises InputError for a function without counterpart in generated code.
        """
        if isinstance(expression, sp.Symbol):
            return self.symbol(expression)
        if expression.is_number:
            return self._constant(expression)
        if isinstance(expression, sp.Add):
            return self._sum(expression)
        if isinstance(expression, sp.Mul):
            return self._product(expression)
        if isinstance(expression, sp.Pow):
            return self._power(*expression.as_base_exp())
        return self._function(expression)

    def _constant(self, expression: sp.Expr) -> T:
        value = float(expression)
        return self.negate(self.number(-value)) if value < 0 else self.number(value)

    def _sum(self, expression: sp.Add) -> T:
        """The terms from left to right, positive ones first; negative ones by subtraction."""
        added = [term for term in expression.args if not _negative(term)]
        subtracted = [term for term in expression.args if _negative(term)]
        if not added:
            return self.negate(reduce(self.add, (self.of(-term) for term in subtracted)))
        total = reduce(self.add, map(self.of, added))
        return reduce(self.subtract, (self.of(-term) for term in subtracted), total)

    def _product(self, expression: sp.Mul) -> T:
        """All factors of the numerator, then one division by the product of the others."""
        if _negative(expression):
            return self.negate(self.of(-expression))
        denominator = [factor for factor in expression.args if _inverse(factor)]
        factors = [self.of(factor) for factor in expression.args if not _inverse(factor)]
        numerator = reduce(self.multiply, factors) if factors else self.number(1.0)
        if not denominator:
            return numerator
        return self.divide(numerator, reduce(self.multiply, (self.of(1 / factor) for factor in denominator)))

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> T:
        if _inverse(base**exponent):
            return self.divide(self.number(1.0), self.of(base ** (-exponent)))
        if exponent.is_Integer:
            return self.power(self.of(base), int(exponent))
        if exponent == sp.S.Half:
            return self.call("sqrt", self.of(base))
        return self.call("pow", self.of(base), self.of(exponent))

    def _function(self, expression: sp.Expr) -> T:
        if isinstance(expression, sp.DiracDelta):
            return self.number(0.0)  # the derivative of a step: zero everywhere but at the step
        arguments = [self.of(argument) for argument in expression.args]
        sympy_name = expression.func.__name__
        if sympy_name in VARIADIC_FUNCTIONS:
            name = VARIADIC_FUNCTIONS[sympy_name]
            return reduce(lambda left, right: self.call(name, left, right), arguments)
        if sympy_name in ELEMENTARY_FUNCTIONS:
            count = 1 if expression.func is sp.Heaviside else len(arguments)
            return self.call(ELEMENTARY_FUNCTIONS[sympy_name], *arguments[:count])
        what = f"the function {expression.func} has no counterpart in generated code"
        raise InputError(what=what, where="emit", remedy="leave the effect out")


def _negative(term: sp.Expr) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)


def _inverse(factor: sp.Expr) -> bool:
    """Whether it is a power with a negative exponent."""
    return isinstance(factor, sp.Pow) and bool(factor.exp.is_number and factor.exp.is_negative)
