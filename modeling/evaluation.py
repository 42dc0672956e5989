"""Evaluation: a tape run over arrays of samples, each operation once for a block of them.

What depends on parameters alone is computed once for all samples, and what depends on the signals alone once for all
parameter sets. A block is as long as its values fit into the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.tape import NONE, Tape

Array = NDArray[np.float64]
Values = NDArray[np.float64] | NDArray[np.complex128]

CACHE = 2**17
"""Numbers that a block's values take at most: 1 MB, what a core has for itself."""
SHORTEST, LONGEST = 256, 4096
"""Samples in a block: fewer, and calling NumPy takes longer than counting; more bring nothing."""


def _sq(x: Array, out: Array) -> Array:
    return np.multiply(x, x, out)


def _twice(x: Array, out: Array) -> Array:
    return np.add(x, x, out)


def _logical_not(x: Array, out: Array) -> Array:
    return np.equal(x, 0.0, out)


def _if_else_zero(condition: Array, x: Array, out: Array) -> None:
    out[...] = np.where(condition != 0, x, 0.0)


FUNCTIONS: Mapping[str, Callable[..., object]] = {
    **{name: getattr(np, name) for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: getattr(np, name) for name in ("sign", "fabs", "log1p", "expm1", "fmin", "fmax")},
    "neg": np.negative,
    "sq": _sq,
    "twice": _twice,
    "inv": np.reciprocal,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "not": _logical_not,
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "pow": np.power,
    "constpow": np.power,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "atan2": np.arctan2,
    "if_else_zero": _if_else_zero,
}
"""What each operation is in NumPy, called with its operands and the array that the result goes into."""

Step = tuple[Callable[..., object], int, int, int]
"""A function, the places of its operands (`NONE` for no second one), and the place of what it makes."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A tape of signals that differ from sample to sample; parameters do so when they are `varying`."""

    tape: Tape
    varying: bool = False
    dtype: type[float] | type[complex] = float

    def run(self, inputs: Sequence[Values], theta: Array, outputs: Sequence[Values]) -> None:
        """Put the results into `outputs`, one array (samples, g) for each.

        inputs (samples,) each, theta (g, k); or (k, samples) when it is `varying`, and then g is 1. Outputs of results
        that are zero whatever the inputs are not touched.
        """
        if not all(output.size for output in outputs):
            return
        with np.errstate(all="ignore"):  # where a value is not finite it says so itself
            fixed = self._fixed([] if self.varying else list(theta.T))
            for output, place in self.plan.known:
                outputs[output][...] = fixed[place]
            if self.plan.outputs:
                changing = [*inputs, *(theta if self.varying else ())]
                self._blocks(fixed, changing, [outputs[output] for output in self.plan.outputs])

    def _fixed(self, parameters: list[Array]) -> list[Any]:
        """Values (g,) of the parameters, then of the constants (), then of what is made of these alone."""
        values = [*parameters, *(np.array(constant) for constant in self.tape.constants)]
        for function, a, b, _ in self.plan.of_parameters:
            taken = [values[place] for place in (a, b) if place != NONE]
            made = np.empty(np.broadcast_shapes(*(value.shape for value in taken)), self.dtype)
            function(*taken, made)
            values.append(made)
        return values

    def _blocks(self, fixed: list[Any], changing: list[Any], outputs: list[Any]) -> None:
        """Run the samples, block by block."""
        plan, (samples, sets) = self.plan, outputs[0].shape
        scalars = [[value[row, ...] if value.ndim else value for value in fixed] for row in range(sets)]
        length = min(max(CACHE // max(plan.rows, 1), SHORTEST), LONGEST, samples)
        work, unset = np.empty((plan.rows, length), self.dtype), [None] * len(outputs)
        begin = len(fixed) + len(changing)
        for start in range(0, samples, length):
            stop = min(start + length, samples)
            values: list[Any] = [*scalars[0], *(column[start:stop] for column in changing), *unset]
            values += list(work[:, : stop - start])
            _take(plan.of_signals, values)
            for row in range(sets):
                values[: len(fixed)] = scalars[row]
                values[begin : begin + len(outputs)] = [output[start:stop, row] for output in outputs]
                _take(plan.of_both, values)

    @cached_property
    def plan(self) -> Plan:
        """What is done in which order, and where values are held."""
        return Plan.of(self.tape, self.varying)


def _take(steps: Sequence[Step], values: list[Any]) -> None:
    for function, a, b, made in steps:
        if b == NONE:
            function(values[a], values[made])
        else:
            function(values[a], values[b], values[made])


@dataclass(frozen=True, eq=False)
class Plan:
    """The operations of a tape by what they depend on, and places for what they make.

    of_parameters   on parameters and constants alone: each makes the value of the next place after these
    of_signals      on signals alone
    of_both         on both, and what puts results into the outputs
    known           results of parameters alone that are not zero for certain: the output, and the place of the value
    outputs         the results that differ from sample to sample
    rows            values of samples that are held at the same time

    Places are, in this order: what is the same for all samples, the changing inputs, the outputs, the rows.
    """

    of_parameters: tuple[Step, ...]
    of_signals: tuple[Step, ...]
    of_both: tuple[Step, ...]
    known: tuple[tuple[int, int], ...]
    outputs: tuple[int, ...]
    rows: int

    @classmethod
    def of(cls, tape: Tape, varying: bool) -> Plan:
        """The plan of a tape."""
        signals, both = _dependent(tape, varying)
        inputs = tape.inputs + (tape.parameters if varying else 0)
        alone = [n for n in range(inputs, tape.size) if n not in signals and n not in both]
        order = [*alone, *range(inputs)]
        places = {number: place for place, number in enumerate(order)}
        zero = {n for n, constant in enumerate(tape.constants, tape.first - len(tape.constants)) if constant == 0}
        same = set(alone)
        known = tuple((o, places[n]) for o, n in enumerate(tape.results) if n in same and n not in zero)
        outputs = tuple(output for output, number in enumerate(tape.results) if number not in same)
        of_parameters = [_step(tape, number, places) for number in alone if number >= tape.first]
        rows = _Rows(tape, places, begin=len(order) + len(outputs))
        puts: dict[int, list[int]] = {}
        for place, output in enumerate(outputs, start=len(order)):
            puts.setdefault(tape.results[output], []).append(place)
        shared = {operand for n in both for operand in tape.operation(n)[1:]} | set(puts)
        of_signals = [rows.step(number, kept=shared) for number in sorted(signals)]
        early = [number for number in puts if number not in both]
        of_both: list[Step] = [(np.positive, places[number], NONE, place) for number in early for place in puts[number]]
        for number in sorted(both):
            of_both.append(rows.step(number, kept=signals))
            of_both += [(np.positive, places[number], NONE, place) for place in puts.get(number, ())]
        return cls(tuple(of_parameters), tuple(of_signals), tuple(of_both), known, outputs, rows.count)


def _dependent(tape: Tape, varying: bool) -> tuple[set[int], set[int]]:
    """The operations that depend on signals alone, and those that depend on parameters too."""
    changing = tape.inputs + (tape.parameters if varying else 0)
    moved = [number < changing for number in range(tape.first)]
    fitted = [changing <= number < tape.inputs + tape.parameters for number in range(tape.first)]
    for _, a, b in tape.operations:
        moved.append(moved[a] or (b != NONE and moved[b]))
        fitted.append(fitted[a] or (b != NONE and fitted[b]))
    moving = [number for number in range(tape.first, tape.size) if moved[number]]
    return {number for number in moving if not fitted[number]}, {number for number in moving if fitted[number]}


def _step(tape: Tape, number: int, places: Mapping[int, int]) -> Step:
    name, a, b = tape.operation(number)
    return FUNCTIONS[name], places[a], NONE if b == NONE else places[b], places.get(number, NONE)


class _Rows:
    """Rows for values of samples, given back when the last operation that takes a value has it."""

    def __init__(self, tape: Tape, places: dict[int, int], begin: int) -> None:
        self.tape, self.places, self.begin = tape, places, begin
        self.count = 0
        self.free: list[int] = []
        self.last = {operand: n for n in range(tape.first, tape.size) for operand in tape.operation(n)[1:]}

    def step(self, number: int, kept: Collection[int]) -> Step:
        """The step that makes a value; its row may be that of an operand that nothing else takes, unless it is kept."""
        for operand in {*self.tape.operation(number)[1:]}:
            if self.last[operand] == number and operand not in kept and self.places.get(operand, NONE) >= self.begin:
                self.free.append(self.places[operand])
        if not self.free:
            self.free.append(self.begin + self.count)
            self.count += 1
        self.places[number] = self.free.pop()
        return _step(self.tape, number, self.places)
