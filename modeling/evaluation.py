"""Evaluation: a tape run over arrays of samples, each operation once for a block of them.

What depends on parameters alone is computed once for all samples, what depends on the signals alone once for all
parameter sets, and of what depends on both each part as often as the parameters change that it depends on. A block is
as long as its values fit into the processor's cache.
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

ONCE, SEVERAL, EACH = range(3)
"""How often values change from one set of parameters to the next: never, between groups of sets, with each set."""
Levels = tuple[int, ...]
"""The one of these for each parameter."""


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
        levels = () if self.varying else _levels(theta)
        plan = self._plan(levels)
        with np.errstate(all="ignore"):  # where a value is not finite it says so itself
            fixed = self._fixed(plan, [], 1) if self.varying else self._fixed(plan, list(theta.T), len(theta))
            for output, place in plan.known:
                outputs[output][...] = fixed[place]
            if plan.outputs:
                changing = [*inputs, *(theta if self.varying else ())]
                order = (
                    _order(theta, levels) if plan.of_several else [(row, False) for row in range(outputs[0].shape[1])]
                )
                _blocks(plan, fixed, changing, [outputs[output] for output in plan.outputs], order, self.dtype)

    def _fixed(self, plan: Plan, parameters: list[Array], sets: int) -> list[Any]:
        """Values (g,) of the parameters, then of the constants (), then of what is made of these alone, (g,)."""
        steps = plan.of_parameters
        values = [*parameters, *self._constants, *np.empty((len(steps), sets), self.dtype)]
        _take(steps, values)
        return values

    @cached_property
    def _constants(self) -> list[Any]:
        """The constants as arrays ()."""
        return [np.array(constant) for constant in self.tape.constants]

    @cached_property
    def _plans(self) -> dict[Levels, Plan]:
        return {}

    def _plan(self, levels: Levels) -> Plan:
        """What is done in which order, and where values are held."""
        if levels not in self._plans:
            self._plans[levels] = Plan.of(self.tape, levels)
        return self._plans[levels]


def _levels(theta: Array) -> Levels:
    """How often each parameter changes over sets theta (g, k), in the order in which the most is shared.

    The one that changes with each set is the one without which the fewest different sets are left.
    """
    sets, count = theta.shape
    if sets == 1:
        return tuple([EACH] * count)
    moving = np.flatnonzero((theta != theta[0]).any(axis=0))
    left = [len(np.unique(theta[:, moving[moving != i]], axis=0)) for i in moving] if len(moving) > 1 else []
    several = SEVERAL if left and 2 * min(left) <= sets else EACH
    most = int(moving[int(np.argmin(left))]) if left else NONE
    changing = set(moving.tolist())
    return tuple((EACH if i == most else several) if i in changing else ONCE for i in range(count))


def _order(theta: Array, levels: Levels) -> list[tuple[int, bool]]:
    """The sets, group after group, and whether each begins a group."""
    grouping = theta[:, [level == SEVERAL for level in levels]]
    order = np.lexsort(grouping.T)
    begins = np.append(True, (np.diff(grouping[order], axis=0) != 0).any(axis=1))
    return list(zip(map(int, order), map(bool, begins), strict=True))


def _blocks(
    plan: Plan,
    fixed: list[Any],
    changing: list[Any],
    outputs: list[Any],
    order: Sequence[tuple[int, bool]],
    dtype: type[float] | type[complex],
) -> None:
    """Run the samples, block by block, in each the sets in that order."""
    samples, sets = outputs[0].shape
    scalars = [[value[row, ...] if value.ndim else value for value in fixed] for row in range(sets)]
    length = min(max(CACHE // max(plan.rows, 1), SHORTEST), LONGEST, samples)
    work, unset = np.empty((plan.rows, length), dtype), [None] * len(outputs)
    begin = len(fixed) + len(changing)
    for start in range(0, samples, length):
        stop = min(start + length, samples)
        values: list[Any] = [*scalars[0], *(column[start:stop] for column in changing), *unset]
        values += list(work[:, : stop - start])
        _take(plan.of_signals, values)
        for row, begins in order:
            values[: len(fixed)] = scalars[row]
            if begins:
                _take(plan.of_several, values)
            values[begin : begin + len(outputs)] = [output[start:stop, row] for output in outputs]
            _take(plan.of_each, values)


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
    of_signals      on signals, and parameters that are the same in all sets
    of_several      on signals and parameters, none of which changes with each set
    of_each         on a parameter that does; and what puts results into the outputs
    known           results of parameters alone that are not zero for certain: the output, and the place of the value
    outputs         the results that differ from sample to sample
    rows            values of samples that are held at the same time

    Places are, in this order: what is the same for all samples, the changing inputs, the outputs, the rows.
    """

    of_parameters: tuple[Step, ...]
    of_signals: tuple[Step, ...]
    of_several: tuple[Step, ...]
    of_each: tuple[Step, ...]
    known: tuple[tuple[int, int], ...]
    outputs: tuple[int, ...]
    rows: int

    @classmethod
    def of(cls, tape: Tape, levels: Levels) -> Plan:
        """The plan of a tape whose parameters change so often; no `levels` where they differ from sample to sample."""
        inputs = tape.inputs + tape.parameters - len(levels)
        moved, often = _dependence(tape, inputs, levels)
        same = [number for number in range(inputs, tape.size) if not moved[number]]
        places = [NONE] * (tape.size + 1)  # the last is that of `NONE`
        for place, number in enumerate((*same, *range(inputs))):
            places[number] = place
        zero = {n for n, constant in enumerate(tape.constants, tape.first - len(tape.constants)) if constant == 0}
        moving = [output for output, number in enumerate(tape.results) if moved[number]]
        still = [o for o, n in enumerate(tape.results) if not moved[n] and n not in zero]
        known = tuple((output, places[tape.results[output]]) for output in still)
        puts: dict[int, list[int]] = {}
        for place, output in enumerate(moving, start=len(same) + inputs):
            puts.setdefault(tape.results[output], []).append(place)
        parts: dict[int | None, list[Numbered]] = {None: [], ONCE: [], SEVERAL: [], EACH: []}
        for number, operation in enumerate(tape.operations, start=tape.first):
            parts[often[number] if moved[number] else None].append((number, operation))
        fixed = tuple((FUNCTIONS[name], places[a], places[b], places[n]) for n, (name, a, b) in parts[None])
        rows = _Rows(tape, places, begin=len(same) + inputs + len(moving))
        later = {o for level in (SEVERAL, EACH) for _, (_, *operands) in parts[level] for o in operands} | set(puts)
        of_signals = [rows.step(number, operation, kept=later) for number, operation in parts[ONCE]]
        later = {number for number, _ in parts[ONCE]} | {o for _, (_, *operands) in parts[EACH] for o in operands}
        of_several = [rows.step(number, operation, kept=later | set(puts)) for number, operation in parts[SEVERAL]]
        held = {number for level in (ONCE, SEVERAL) for number, _ in parts[level]}
        early = [number for number in puts if number < tape.first or often[number] != EACH]
        of_each: list[Step] = [(np.positive, places[number], NONE, place) for number in early for place in puts[number]]
        for number, operation in parts[EACH]:
            of_each.append(rows.step(number, operation, kept=held))
            of_each += [(np.positive, places[number], NONE, place) for place in puts.get(number, ())]
        return cls(fixed, tuple(of_signals), tuple(of_several), tuple(of_each), known, tuple(moving), rows.count)


def _dependence(tape: Tape, inputs: int, levels: Levels) -> tuple[list[bool], list[int]]:
    """Whether each value differs from sample to sample, and how often it changes from set to set."""
    constants = len(tape.constants)
    moved = [True] * inputs + [False] * (len(levels) + constants)
    often = [ONCE] * inputs + [*levels] + [ONCE] * constants
    for _, a, b in tape.operations:
        moved.append(moved[a] or (b != NONE and moved[b]))
        often.append(often[a] if b == NONE else max(often[a], often[b]))
    return moved, often


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
