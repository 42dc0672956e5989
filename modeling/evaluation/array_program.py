"""Straight-line array program as plain data, evaluated by NumPy ufuncs in preallocated rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Operand: TypeAlias = int | float

UFUNCS: Mapping[str, np.ufunc] = {
    **{name: getattr(np, name) for name in ("add", "subtract", "multiply", "divide", "negative", "square")},
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt")},
    **{name: getattr(np, name) for name in ("sign", "fabs", "fmax", "fmin")},
    **{"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "pow": np.power},
    "step": np.heaviside,
}
"""NumPy's ufunc of each operation, by C's names where C has them; `step` takes its value at 0 as second operand."""


@dataclass(frozen=True)
class ArrayOperation:
    """One operation. An int operand is the index of a value, a float a constant."""

    operation: str
    operands: tuple[Operand, ...]


@dataclass(frozen=True)
class ArrayProgram:
    """Values 0, 1, ..: the inputs in order, then one for each step; results are indices of values, or constants.

    It is data, not code: its operations are looked up in `UFUNCS`.
    """

    inputs: tuple[str, ...]
    steps: tuple[ArrayOperation, ...]
    results: tuple[Operand, ...]

    def to_data(self) -> dict[str, Any]:
        """The program as lists, strings and numbers."""
        return {
            "inputs": list(self.inputs),
            "steps": [[step.operation, *step.operands] for step in self.steps],
            "results": list(self.results),
        }

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """The program from the result of `to_data`. Raises ValueError for invalid data."""
        steps = tuple(ArrayOperation(operation, tuple(operands)) for operation, *operands in data["steps"])
        inputs = tuple(data["inputs"])
        for place, step in enumerate(steps, start=len(inputs)):
            if step.operation not in UFUNCS or not all(_is_valid(v, place) for v in step.operands):
                raise ValueError(f"step {place - len(inputs)} of a program, {step}, cannot be evaluated")
        results = tuple(data["results"])
        if not all(_is_valid(value, len(inputs) + len(steps)) for value in results):
            raise ValueError(f"results {results} of a program cannot be evaluated")
        return cls(inputs, steps, results)

    @cached_property
    def _places(self) -> tuple[tuple[int, ...], int]:
        """Where each step writes: row i of the results as i, scratch row j as -1 - j; and the number of scratch rows.

        A scratch row is reused after its last read; the step that reads it last may overwrite it.
        """
        first = len(self.inputs)
        rows = {value: i for i, value in reversed(list(enumerate(self.results))) if isinstance(value, int)}
        last = {v: at for at, step in enumerate(self.steps) for v in step.operands if isinstance(v, int)}
        free: list[int] = []
        places: list[int] = []
        scratch = 0
        for at, step in enumerate(self.steps):
            for v in {
                v for v in step.operands if isinstance(v, int) and v >= first and v not in rows and last[v] == at
            }:
                free.append(places[v - first])
            if first + at in rows:
                places.append(rows[first + at])
                continue
            if not free:
                scratch += 1
                free.append(-scratch)
            places.append(free.pop())
        return tuple(places), scratch

    def scratch(self, samples: int) -> Array:
        """Scratch rows (rows, samples) for `into`."""
        return np.empty((self._places[1], samples))

    def into(self, out: Array, columns: Sequence[Array], scratch: Array) -> None:
        """Write the results of n samples to the rows of `out` (results, n), from the inputs (n,) each, in order."""
        values: list[Any] = list(columns)
        n = out.shape[1]
        for step, place in zip(self.steps, self._places[0], strict=True):
            target = out[place] if place >= 0 else scratch[-1 - place, :n]
            operands = [values[v] if isinstance(v, int) else v for v in step.operands]
            UFUNCS[step.operation](*operands, out=target)
            values.append(target)
        for row, value in enumerate(self.results):
            if not isinstance(value, int):
                out[row] = value
            elif value < len(self.inputs) or self._places[0][value - len(self.inputs)] != row:
                out[row] = values[value]


def _is_valid(operand: object, count: int) -> bool:
    """Whether an operand is a constant, or the index of an earlier value."""
    return type(operand) is float or (type(operand) is int and 0 <= operand < count)
