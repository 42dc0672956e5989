"""Partial evaluation: a tape with some parameters fixed, constants folded, in canonical order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from modeling.evaluation.tape import NO_OPERAND, Tape
from modeling.evaluation.tape_evaluation import NUMPY_OPERATIONS

TapeOperand = float | int
"""A constant, or the number of a value that is not constant."""


def partially_evaluated(tape: Tape, fixed: Mapping[int, float]) -> Tape:
    """The tape with the parameters in `fixed` at these values; their number k stays.

    A product with zero is zero, even of what is not finite. Operations come depth first from the results, without dead
    code: equal derivations give equal tapes.
    """
    known = {tape.inputs + parameter: value for parameter, value in fixed.items()}
    values: list[TapeOperand] = [float(known[n]) if n in known else n for n in range(tape.inputs + tape.parameters)]
    values += list(tape.constants)
    remaining = _RemainingOperations(values)
    for name, a, b in tape.operations:
        values.append(remaining.result(name, values[a], NO_OPERAND if b == NO_OPERAND else values[b]))
    return _CanonicalTape(tape, remaining).tape([values[result] for result in tape.results])


@dataclass
class _RemainingOperations:
    """Operations that cannot be folded, by the numbers of their values; operands are numbers (int) or floats."""

    values: list[TapeOperand]
    operations: dict[int, tuple[str, TapeOperand, TapeOperand]] = field(default_factory=dict)

    def result(self, name: str, a: TapeOperand, b: TapeOperand) -> TapeOperand:
        """The value of an operation: a constant, an existing value, or a new one."""
        if isinstance(a, float) or isinstance(b, float):
            if all(isinstance(operand, float) or operand == NO_OPERAND for operand in (a, b)):
                return _folded(name, *(operand for operand in (a, b) if isinstance(operand, float)))
            simpler = _simplified(name, a, b)
            if simpler is not None:
                return simpler
            if name == "sub" and a == 0.0 and isinstance(a, float):
                name, a, b = "neg", b, NO_OPERAND
        self.operations[len(self.values)] = (name, a, b)
        return len(self.values)


def _folded(name: str, *operands: float) -> float:
    """The value of an operation on constants."""
    found = np.empty(())
    with np.errstate(all="ignore"):
        NUMPY_OPERATIONS[name](*map(np.array, operands), found)
    return float(found)


def _simplified(name: str, a: TapeOperand, b: TapeOperand) -> TapeOperand | None:
    """An operation with one operand 0 or 1, simplified; None when it is needed."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float) and name == "mul" and one in (0.0, 1.0):
            return other if one else 0.0
        if isinstance(one, float) and name == "add" and one == 0.0:
            return other
    if isinstance(b, float) and ((name == "sub" and b == 0.0) or (name == "div" and b == 1.0)):
        return a
    if isinstance(a, float) and a == 0.0 and name in ("div", "if_else_zero"):
        return 0.0
    return None


class _CanonicalTape:
    """A tape rewritten from its results, depth first."""

    def __init__(self, tape: Tape, remaining: _RemainingOperations) -> None:
        self.source, self.remaining = tape, remaining
        self.constants: dict[float, int] = {}
        self.order: dict[int, int] = {}

    def tape(self, results: list[TapeOperand]) -> Tape:
        """The tape of these results."""
        for result in results:
            self._visit(result)
        first_constant = self.source.inputs + self.source.parameters
        first_operation = first_constant + len(self.constants)
        constants = {value: i for i, value in enumerate(self.constants, start=first_constant)}
        number_of = {value: i for i, value in enumerate(self.order, start=first_operation)}

        def number(value: TapeOperand) -> int:
            return constants[value] if isinstance(value, float) else number_of.get(value, value)

        ordered = map(self.remaining.operations.__getitem__, self.order)
        operations = tuple((name, number(a), number(b)) for name, a, b in ordered)
        numbers = tuple(map(number, results))
        return Tape(self.source.inputs, self.source.parameters, tuple(constants), operations, numbers)

    def _visit(self, result: TapeOperand) -> None:
        operations, order = self.remaining.operations, self.order
        stack: list[tuple[TapeOperand, bool]] = [(result, False)]
        while stack:
            value, ready = stack.pop()
            if isinstance(value, float):
                self.constants.setdefault(value, len(self.constants))
            elif ready:
                order.setdefault(value, len(order))
            elif value in operations and value not in order:
                _, a, b = operations[value]
                stack += ((value, True), (b, False), (a, False))
