"""Arithmetic that translates expressions into the operations of an array program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from modeling import symbolic as sp
from modeling.evaluation.array_program import UFUNCS, ArrayOperation, ArrayProgram, Operand
from modeling.expressions.arithmetic import Arithmetic
from modeling.expressions.straight_line_program import StraightLineProgram


@dataclass(frozen=True)
class ArrayArithmetic(Arithmetic[Operand]):
    """Expressions as operands of a growing array program; constant subexpressions are folded."""

    known: dict[sp.Symbol, Operand]
    inputs: int
    steps: list[ArrayOperation] = field(default_factory=list)

    def _step(self, operation: str, *operands: Operand) -> Operand:
        if not any(isinstance(operand, int) for operand in operands):
            return float(UFUNCS[operation](*operands))
        self.steps.append(ArrayOperation(operation, operands))
        return self.inputs + len(self.steps) - 1

    def number(self, value: float) -> Operand:
        """A constant, always a float."""
        return float(value)

    def symbol(self, symbol: sp.Symbol) -> Operand:
        """The operand of the symbol."""
        return self.known[symbol]

    def add(self, left: Operand, right: Operand) -> Operand:
        """left + right."""
        return self._step("add", left, right)

    def subtract(self, left: Operand, right: Operand) -> Operand:
        """left - right."""
        return self._step("subtract", left, right)

    def multiply(self, left: Operand, right: Operand) -> Operand:
        """left * right."""
        return self._step("multiply", left, right)

    def divide(self, left: Operand, right: Operand) -> Operand:
        """left / right."""
        return self._step("divide", left, right)

    def negate(self, value: Operand) -> Operand:
        """-value."""
        return self._step("negative", value)

    def power(self, base: Operand, exponent: int) -> Operand:
        """base * base * .., by repeated multiplication."""
        value = self._step("square", base)
        for _ in range(exponent - 2):
            value = self._step("multiply", value, base)
        return value

    def call(self, name: str, *arguments: Operand) -> Operand:
        """A function; a step is one half at 0, as in generated code."""
        return self._step(name, *arguments, *((0.5,) if name == "step" else ()))


def array_program(inputs: Sequence[sp.Symbol], expressions: Sequence[sp.Expr]) -> ArrayProgram:
    """The array program of expressions of these inputs, common subexpressions shared.

    Raises InputError for a function without counterpart in generated code.
    """
    program = StraightLineProgram.of(expressions).shared
    arithmetic = ArrayArithmetic({symbol: i for i, symbol in enumerate(inputs)}, len(inputs))
    for symbol, expression in program.steps:
        arithmetic.known[symbol] = arithmetic.of(expression)
    results = tuple(arithmetic.of(expression) for expression in program.results)
    return ArrayProgram(tuple(symbol.name for symbol in inputs), tuple(arithmetic.steps), results)
