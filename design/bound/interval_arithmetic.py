"""Interval arithmetic of tapes over many boxes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.evaluation.tape import NO_OPERAND, Tape

Array = NDArray[np.float64]
IntervalArrays = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class IntervalEvaluation:
    """A tape without parameters, evaluated with intervals, operation by operation (R. E. Moore, 1966).

    Every operation gives an interval that contains all its values over the arguments' intervals, so that the result
    encloses the range of the function over a box. Ends are rounded to nearest: valid up to rounding.

    Raises InputError for an operation that has no enclosure here.
    """

    tape: Tape

    def __call__(self, low: Array, high: Array) -> IntervalArrays:
        """Enclosures low and high (N, results) over boxes from low to high, (N, inputs)."""
        tape = self.tape
        last = {operand: at for at, (_, *operands) in enumerate(tape.operations) for operand in operands}
        values: dict[int, IntervalArrays] = dict(enumerate(zip(low.T, high.T, strict=True)))
        for i, constant in enumerate(tape.constants):
            everywhere = np.full(len(low), constant)
            values[tape.inputs + i] = everywhere, everywhere
        for at, (name, *numbers) in enumerate(tape.operations):
            if name not in INTERVAL_OPERATIONS:
                what = f"the operation '{name}' has no enclosure, so that no bound can be proven for this model"
                raise InputError(what=what, where="proof", remedy="take the bound without a proof")
            operands = [number for number in numbers if number != NO_OPERAND]
            values[tape.first + at] = INTERVAL_OPERATIONS[name](*(values[number] for number in operands))
            for number in {*operands} - {*tape.results}:
                if last[number] == at:
                    del values[number]  # not read again
        ends = [values[number] for number in tape.results]
        return np.stack([below for below, _ in ends], axis=1), np.stack([above for _, above in ends], axis=1)


def _product(a: IntervalArrays, b: IntervalArrays) -> IntervalArrays:
    corners = (a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])
    low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
    high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
    return low, high


def _quotient(a: IntervalArrays, b: IntervalArrays) -> IntervalArrays:
    """The whole real line where the divisor's interval contains zero."""
    crosses = (b[0] <= 0) & (b[1] >= 0)
    low, high = np.where(crosses, 1.0, b[1]), np.where(crosses, 1.0, b[0])
    below, above = _product(a, (1 / low, 1 / high))
    return np.where(crosses, -np.inf, below), np.where(crosses, np.inf, above)


def _square(a: IntervalArrays) -> IntervalArrays:
    first, second = a[0] ** 2, a[1] ** 2
    spans = (a[0] <= 0) & (a[1] >= 0)
    return np.where(spans, 0.0, np.minimum(first, second)), np.maximum(first, second)


def _sine(a: IntervalArrays) -> IntervalArrays:
    """-1 or 1 where the interval contains a minimum or maximum of sin, else the values at the ends."""
    first, second = np.sin(a[0]), np.sin(a[1])
    top = np.ceil((a[0] - np.pi / 2) / (2 * np.pi)) * 2 * np.pi + np.pi / 2 <= a[1]
    bottom = np.ceil((a[0] + np.pi / 2) / (2 * np.pi)) * 2 * np.pi - np.pi / 2 <= a[1]
    low, high = np.minimum(first, second), np.maximum(first, second)
    return np.where(bottom, -1.0, low), np.where(top, 1.0, high)


INTERVAL_OPERATIONS: Mapping[str, Callable[..., IntervalArrays]] = {
    "add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: (a[0] - b[1], a[1] - b[0]),
    "neg": lambda a: (-a[1], -a[0]),
    "twice": lambda a: (2 * a[0], 2 * a[1]),
    "mul": _product,
    "div": _quotient,
    "inv": lambda a: _quotient((np.ones_like(a[0]), np.ones_like(a[1])), a),
    "sq": _square,
    "sin": _sine,
    "cos": lambda a: _sine((a[0] + np.pi / 2, a[1] + np.pi / 2)),
}
"""The enclosure of each operation, by its name on a tape."""
