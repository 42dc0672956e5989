"""Arithmetic: what an expression is evaluated in, be it numbers of operations, text of a language or a graph."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import reduce
from typing import Generic, TypeVar

from modeling import symbolic as sp
from modeling.errors import InputError

T = TypeVar("T")

FUNCTIONS: dict[str, str] = {
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
"""Functions of SymPy by their names there, under the name that arithmetics know them by: C's, where C has it."""

FOLDED = {"Max": "fmax", "Min": "fmin"}
"""Functions of any number of arguments, taken two at a time."""


class Arithmetic(ABC, Generic[T]):
    """Sums, products and functions of things T. Subtraction, division and powers have their own, as a machine has."""

    @abstractmethod
    def number(self, value: float) -> T:
        """A constant."""

    @abstractmethod
    def symbol(self, symbol: sp.Symbol) -> T:
        """An input, a parameter, or a step that was evaluated before."""

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
        """The value with the other sign."""

    @abstractmethod
    def power(self, base: T, exponent: int) -> T:
        """A product of so many factors, two or more."""

    @abstractmethod
    def call(self, name: str, *arguments: T) -> T:
        """A function by its name in FUNCTIONS and FOLDED, `sqrt` or `pow`."""

    def of(self, expression: sp.Expr) -> T:
        """The expression in this arithmetic.

        Raises InputError for what no emitted code could evaluate.
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
        """The terms from left to right, one that is added first; what is subtracted as such."""
        added = [term for term in expression.args if not _negative(term)]
        taken = [term for term in expression.args if _negative(term)]
        if not added:
            return self.negate(reduce(self.add, (self.of(-term) for term in taken)))
        total = reduce(self.add, map(self.of, added))
        return reduce(self.subtract, (self.of(-term) for term in taken), total)

    def _product(self, expression: sp.Mul) -> T:
        """All factors of the numerator, then one division by the product of the others."""
        if _negative(expression):
            return self.negate(self.of(-expression))
        below = [factor for factor in expression.args if _inverse(factor)]
        above = [self.of(factor) for factor in expression.args if not _inverse(factor)]
        numerator = reduce(self.multiply, above) if above else self.number(1.0)
        if not below:
            return numerator
        return self.divide(numerator, reduce(self.multiply, (self.of(1 / factor) for factor in below)))

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
            return self.number(0.0)  # the derivative of a jump, which is nothing everywhere but there
        arguments = [self.of(argument) for argument in expression.args]
        own = expression.func.__name__
        if own in FOLDED:
            name = FOLDED[own]
            return reduce(lambda left, right: self.call(name, left, right), arguments)
        if own in FUNCTIONS:
            wanted = 1 if expression.func is sp.Heaviside else len(arguments)
            return self.call(FUNCTIONS[own], *arguments[:wanted])
        what = f"the function {expression.func} has no counterpart in emitted code"
        raise InputError(what=what, where="emit", remedy="leave the effect out")


def _negative(term: sp.Expr) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)


def _inverse(factor: sp.Expr) -> bool:
    """Whether it is something to a negative power."""
    return isinstance(factor, sp.Pow) and bool(factor.exp.is_number and factor.exp.is_negative)
