"""Interval arithmetic of CasADi functions over many boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError

Array = NDArray[np.float64]
IntervalArrays = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class IntervalFunction:
    """A CasADi SX function of one column, evaluated with intervals, operation by operation (R. E. Moore, 1966).

    Every operation gives an interval that contains all its values over the arguments' intervals, so that the result
    encloses the range of the function over a box. Ends are rounded to nearest: valid up to rounding.

    Raises InputError for an operation that has no enclosure here.
    """

    function: Any

    @cached_property
    def _program(self) -> list[tuple[int, list[int], list[int], float]]:
        f = self.function
        return [
            (f.instruction_id(i), f.instruction_input(i), f.instruction_output(i), _constant(f, i))
            for i in range(f.n_instructions())
        ]

    def __call__(self, low: Array, high: Array) -> IntervalArrays:
        """Enclosures low and high (N, outputs) over boxes from low to high, (N, inputs)."""
        import casadi as ca

        work: dict[int, IntervalArrays] = {}
        results: dict[int, IntervalArrays] = {}
        operations = _operations()
        for code, inputs, outputs, constant in self._program:
            if code == ca.OP_INPUT:
                work[outputs[0]] = (low[:, inputs[1]], high[:, inputs[1]])
            elif code == ca.OP_CONST:
                work[outputs[0]] = (np.full(len(low), constant),) * 2
            elif code == ca.OP_OUTPUT:
                results[outputs[1]] = work[inputs[0]]
            elif code in operations:
                work[outputs[0]] = operations[code](*(work[i] for i in inputs))
            else:
                what = f"CasADi's operation {code} has no enclosure, so that no bound can be proven for this model"
                raise InputError(what=what, where="proof", remedy="take the bound without a proof")
        ordered = [results[i] for i in sorted(results)]
        return np.stack([r[0] for r in ordered], axis=1), np.stack([r[1] for r in ordered], axis=1)


def _constant(function: Any, place: int) -> float:
    import casadi as ca

    return float(function.instruction_constant(place)) if function.instruction_id(place) == ca.OP_CONST else 0.0


def _operations() -> dict[int, Callable[..., IntervalArrays]]:
    import casadi as ca

    return {
        ca.OP_ADD: lambda a, b: (a[0] + b[0], a[1] + b[1]),
        ca.OP_SUB: lambda a, b: (a[0] - b[1], a[1] - b[0]),
        ca.OP_NEG: lambda a: (-a[1], -a[0]),
        ca.OP_TWICE: lambda a: (2 * a[0], 2 * a[1]),
        ca.OP_MUL: _product,
        ca.OP_DIV: _quotient,
        ca.OP_INV: lambda a: _quotient((np.ones_like(a[0]), np.ones_like(a[1])), a),
        ca.OP_SQ: _square,
        ca.OP_SIN: _sine,
        ca.OP_COS: lambda a: _sine((a[0] + np.pi / 2, a[1] + np.pi / 2)),
    }


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
