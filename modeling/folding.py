"""Folding: a tape with some parameters fixed, less the operations that this makes superfluous, in a form of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from modeling.evaluation import FUNCTIONS
from modeling.tape import NONE, Tape

Value = float | int
"""A constant, or the number of a value that stays."""


def folded(tape: Tape, fixed: Mapping[int, float]) -> Tape:
    """The tape with the parameters in `fixed` at these values; it takes as many as before.

    What is multiplied by zero is zero, whatever it is. Operations come in the order in which the results need them,
    and nothing is kept that they do not: equal derivations give equal tapes.
    """
    given = {tape.inputs + parameter: value for parameter, value in fixed.items()}
    values: list[Value] = [float(given[n]) if n in given else n for n in range(tape.inputs + tape.parameters)]
    values += list(tape.constants)
    pending = _Pending(values)
    for name, a, b in tape.operations:
        values.append(pending.made(name, values[a], NONE if b == NONE else values[b]))
    return _Ordered(tape, pending).tape([values[result] for result in tape.results])


@dataclass
class _Pending:
    """Operations that are left, by the numbers of their values; operands are numbers (int) or constants (float)."""

    values: list[Value]
    operations: dict[int, tuple[str, Value, Value]] = field(default_factory=dict)

    def made(self, name: str, a: Value, b: Value) -> Value:
        """The value of an operation: a constant, one that was there, or a new one."""
        if isinstance(a, float) or isinstance(b, float):
            if all(isinstance(operand, float) or operand == NONE for operand in (a, b)):
                return _number(name, *(operand for operand in (a, b) if isinstance(operand, float)))
            simpler = _simpler(name, a, b)
            if simpler is not None:
                return simpler
            if name == "sub" and a == 0.0 and isinstance(a, float):
                name, a, b = "neg", b, NONE
        self.operations[len(self.values)] = (name, a, b)
        return len(self.values)


def _number(name: str, *operands: float) -> float:
    found = np.empty(())
    with np.errstate(all="ignore"):
        FUNCTIONS[name](*map(np.array, operands), found)
    return float(found)


def _simpler(name: str, a: Value, b: Value) -> Value | None:
    """What an operation comes to when one operand is 0 or 1; None when it has to be done."""
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


class _Ordered:
    """A tape written anew from its results, depth first."""

    def __init__(self, tape: Tape, pending: _Pending) -> None:
        self.taken, self.pending = tape, pending
        self.constants: dict[float, int] = {}
        self.order: dict[int, int] = {}

    def tape(self, results: list[Value]) -> Tape:
        """The tape of these results."""
        for result in results:
            self._visit(result)
        begin = self.taken.inputs + self.taken.parameters
        first = begin + len(self.constants)
        constants = {value: place for place, value in enumerate(self.constants, start=begin)}
        made = {value: place for place, value in enumerate(self.order, start=first)}

        def number(value: Value) -> int:
            return constants[value] if isinstance(value, float) else made.get(value, value)

        taken = map(self.pending.operations.__getitem__, self.order)
        operations = tuple((name, number(a), number(b)) for name, a, b in taken)
        numbers = tuple(map(number, results))
        return Tape(self.taken.inputs, self.taken.parameters, tuple(constants), operations, numbers)

    def _visit(self, result: Value) -> None:
        operations, order = self.pending.operations, self.order
        stack: list[tuple[Value, bool]] = [(result, False)]
        while stack:
            value, ready = stack.pop()
            if isinstance(value, float):
                self.constants.setdefault(value, len(self.constants))
            elif ready:
                order.setdefault(value, len(order))
            elif value in operations and value not in order:
                _, a, b = operations[value]
                stack += ((value, True), (b, False), (a, False))
