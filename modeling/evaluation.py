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

from modeling.tape import NONE, Operation, Tape

Array = NDArray[np.float64]
Values = NDArray[np.float64] | NDArray[np.complex128]

CACHE = 2**17
"""Numbers that a block's values take at most: 1 MB, what a core has for itself."""
SHORTEST, LONGEST = 1024, 4096
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
Numbered = tuple[int, Operation]
"""The number of a value, and the operation that makes it."""

OF_SIGNALS, OF_PARAMETERS = 1, 2
OF_BOTH = OF_SIGNALS | OF_PARAMETERS
"""What a value depends on."""


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
            fixed = self._fixed([], 1) if self.varying else self._fixed(list(theta.T), len(theta))
            for output, place in self.plan.known:
                outputs[output][...] = fixed[place]
            if self.plan.outputs:
                changing = [*inputs, *(theta if self.varying else ())]
                self._blocks(fixed, changing, [outputs[output] for output in self.plan.outputs])

    def _fixed(self, parameters: list[Array], sets: int) -> list[Any]:
        """Values (g,) of the parameters, then of the constants (), then of what is made of these alone, (g,)."""
        steps = self.plan.of_parameters
        values = [*parameters, *self._constants, *np.empty((len(steps), sets), self.dtype)]
        _take(steps, values)
        return values

    @cached_property
    def _constants(self) -> list[Any]:
        """The constants as arrays ()."""
        return [np.array(constant) for constant in self.tape.constants]

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
        kinds, inputs = _kinds(tape, varying), tape.inputs + (tape.parameters if varying else 0)
        same = [number for number in range(inputs, tape.size) if not kinds[number] & OF_SIGNALS]
        places = [NONE] * (tape.size + 1)  # the last is that of `NONE`
        for place, number in enumerate((*same, *range(inputs))):
            places[number] = place
        zero = {n for n, constant in enumerate(tape.constants, tape.first - len(tape.constants)) if constant == 0}
        moving = [output for output, number in enumerate(tape.results) if kinds[number] & OF_SIGNALS]
        still = [o for o, n in enumerate(tape.results) if not kinds[n] & OF_SIGNALS and n not in zero]
        known = tuple((output, places[tape.results[output]]) for output in still)
        puts: dict[int, list[int]] = {}
        for place, output in enumerate(moving, start=len(same) + inputs):
            puts.setdefault(tape.results[output], []).append(place)
        of_parameters, signals, both = _parted(tape, kinds)
        fixed = tuple((FUNCTIONS[name], places[a], places[b], places[number]) for number, (name, a, b) in of_parameters)
        rows = _Rows(tape, places, begin=len(same) + inputs + len(moving))
        shared = {operand for _, (_, *operands) in both for operand in operands} | set(puts)
        of_signals = [rows.step(number, operation, kept=shared) for number, operation in signals]
        early = [number for number in puts if kinds[number] != OF_BOTH]
        of_both: list[Step] = [(np.positive, places[number], NONE, place) for number in early for place in puts[number]]
        held = {number for number, _ in signals}
        for number, operation in both:
            of_both.append(rows.step(number, operation, kept=held))
            of_both += [(np.positive, places[number], NONE, place) for place in puts.get(number, ())]
        return cls(fixed, tuple(of_signals), tuple(of_both), known, tuple(moving), rows.count)


def _kinds(tape: Tape, varying: bool) -> list[int]:
    """What each value depends on: `OF_SIGNALS`, `OF_PARAMETERS`, `OF_BOTH`, or 0 for nothing."""
    kinds = [OF_SIGNALS] * tape.inputs + [OF_SIGNALS if varying else OF_PARAMETERS] * tape.parameters
    kinds += [0] * len(tape.constants)
    for _, a, b in tape.operations:
        kinds.append(kinds[a] if b == NONE else kinds[a] | kinds[b])
    return kinds


def _parted(tape: Tape, kinds: Sequence[int]) -> tuple[list[Numbered], list[Numbered], list[Numbered]]:
    """The operations on parameters and constants alone, on signals alone, and on both."""
    parts: dict[int, list[Numbered]] = {kind: [] for kind in (0, OF_PARAMETERS, OF_SIGNALS, OF_BOTH)}
    parts[0] = parts[OF_PARAMETERS]  # in one order
    for numbered in enumerate(tape.operations, start=tape.first):
        parts[kinds[numbered[0]]].append(numbered)
    return parts[OF_PARAMETERS], parts[OF_SIGNALS], parts[OF_BOTH]


class _Rows:
    """Rows for values of samples, given back when the last operation that takes a value has it."""

    def __init__(self, tape: Tape, places: list[int], begin: int) -> None:
        self.places, self.begin = places, begin
        self.count = 0
        self.free: list[int] = []
        self.last = [NONE] * len(places)
        for number, (_, a, b) in enumerate(tape.operations, start=tape.first):
            self.last[a] = self.last[b] = number

    def step(self, number: int, operation: Operation, kept: Collection[int]) -> Step:
        """The step that makes a value; its row may be that of an operand that nothing else takes, unless it is kept."""
        places, last, free = self.places, self.last, self.free
        name, a, b = operation
        left, right = places[a], places[b]
        if last[a] == number and left >= self.begin and a not in kept:
            free.append(left)
        if b != a and last[b] == number and right >= self.begin and b not in kept:
            free.append(right)
        if not free:
            free.append(self.begin + self.count)
            self.count += 1
        places[number] = made = free.pop()
        return FUNCTIONS[name], left, right, made
