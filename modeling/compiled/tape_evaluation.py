"""Blockwise NumPy evaluation of a tape over samples and parameter sets.

Operations on parameters alone run once for all samples, those on signals alone once for all parameter sets, the others
as often as the parameters change that they depend on. The values of a block fit into the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.compiled.tape import NO_OPERAND, Operation, Operations, Tape


def with_half_angles(tape: Tape, angles: Collection[int]) -> Tape:
    """The tape with t = tan(x/2), sin x = 2t / (1 + t²), cos x = (1 - t²) / (1 + t²) for x among `angles`.

    Only an angle of which the tape has both is changed. That is one function of the C library instead of two; with
    AVX-512 NumPy computes tangents eight at once, but sines and cosines one by one. Both are within 2^-52 of their
    exact values, the sine also within 2^-51 of its size.
    """
    operations = tape.operations
    both = operations.operands_of("sin") & operations.operands_of("cos") & set(angles)
    if not both:
        return tape
    half, one, first = tape.first, tape.first + 1, tape.first + 2
    changed: list[Operation] = []
    number = list(range(tape.first))
    parts: dict[int, tuple[int, int, int]] = {}

    def value(name: str, a: int, b: int = NO_OPERAND) -> int:
        changed.append((name, a, b))
        return first + len(changed) - 1

    for name, a, b in operations:
        if name in ("sin", "cos") and a in both:
            if a not in parts:
                tangent = value("tan", value("mul", number[a], half))
                square = value("sq", tangent)
                parts[a] = tangent, square, value("add", square, one)
            tangent, square, denominator = parts[a]
            numerator = value("twice", tangent) if name == "sin" else value("sub", one, square)
            number.append(value("div", numerator, denominator))
        else:
            number.append(value(name, number[a], b if b == NO_OPERAND else number[b]))
    constants = (*tape.constants, 0.5, 1.0)
    results = tuple(number[r] for r in tape.results)
    return Tape(tape.inputs, tape.parameters, constants, Operations.of(changed), results)


Array = NDArray[np.float64]
RealOrComplex = NDArray[np.float64] | NDArray[np.complex128]

BLOCK_NUMBERS = 2**17
"""Numbers in a block's values at most: 1 MB, a core's own cache."""
SHORTEST_BLOCK = 1024
"""Samples in a block at least: with fewer the overhead of NumPy's calls dominates."""
LONGEST_BLOCK = 8192
"""Samples in a block at most: more gain nothing."""


def _sq(x: Array, out: Array) -> Array:
    return np.multiply(x, x, out)


def _twice(x: Array, out: Array) -> Array:
    return np.add(x, x, out)


def _logical_not(x: Array, out: Array) -> Array:
    return np.equal(x, 0.0, out)


def _if_else_zero(condition: Array, x: Array, out: Array) -> None:
    out[...] = np.where(condition != 0, x, 0.0)


NUMPY_OPERATIONS: Mapping[str, Callable[..., object]] = {
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
"""NumPy's function of each operation, called with its operands and the output array."""

Instruction = tuple[Callable[..., object], int, int, int]
"""A function, the slots of its operands (`NO_OPERAND` for no second one), and the slot of its result."""
Numbered = tuple[int, Operation]
"""The number of a value, and its operation."""

CONSTANT, PER_GROUP, PER_SET = range(3)
"""How often values change over the parameter sets: never, between groups of sets, with each set."""
Levels = tuple[int, ...]
"""One of these for each parameter."""


@dataclass(frozen=True, eq=False)
class TapeEvaluation:
    """Evaluation of a tape; with `varying`, parameters change from sample to sample as signals do."""

    tape: Tape
    varying: bool = False
    dtype: type[float] | type[complex] = float

    def run(
        self, inputs: Sequence[RealOrComplex], theta: Array, outputs: Sequence[RealOrComplex], block: int = 1
    ) -> None:
        """Write each result to its array (samples // block, g) of `outputs`, as means over blocks of samples.

        inputs (samples,) each, theta (g, k); or (k, samples) when `varying`, and then g is 1. Outputs of results that
        are identically zero are not written. Means are taken while the samples are in the cache: of a long record at
        a high rate neither the samples nor their sums go through memory.
        """
        if not all(output.size for output in outputs):
            return
        levels = () if self.varying else _levels(theta)
        schedule = self._schedule(levels, single=all(output.shape[1] == 1 for output in outputs))
        with np.errstate(all="ignore"):  # values that are not finite propagate
            fixed = self._fixed(schedule, [], 1) if self.varying else self._fixed(schedule, list(theta.T), len(theta))
            for output, slot in schedule.constant_results:
                outputs[output][...] = fixed[slot]
            if schedule.outputs:
                changing = [*inputs, *(theta if self.varying else ())]
                order = (
                    _order(theta, levels)
                    if schedule.of_several
                    else [(row, False) for row in range(outputs[0].shape[1])]
                )
                written = [outputs[output] for output in schedule.outputs]
                _blocks(schedule, fixed, changing, written, order, self.dtype, block)

    def values(self, inputs: Sequence[Array], theta: Array | None = None) -> Array:
        """The results (results, samples) at inputs (samples,) each and one set of parameters theta (k,), if any."""
        results = np.zeros((len(self.tape.results), len(inputs[0])))
        self.run(inputs, np.zeros((1, 0)) if theta is None else theta[None], list(results[:, :, None]))
        return results

    def _fixed(self, schedule: Schedule, parameters: list[Array], sets: int) -> list[Any]:
        """Parameters (g,), constants (), then values (g,) of operations on these alone."""
        steps = schedule.of_parameters
        values = [*parameters, *self._constants, *np.empty((len(steps), sets), self.dtype)]
        _execute(steps, values)
        return values

    @cached_property
    def _constants(self) -> list[Any]:
        """The constants as arrays ()."""
        return [np.array(constant) for constant in self._evaluated.constants]

    @cached_property
    def _evaluated(self) -> Tape:
        """The tape as it is evaluated: real angles of samples by their halves."""
        if self.dtype is complex:
            return self.tape
        sampled = self.tape.inputs + (self.tape.parameters if self.varying else 0)
        return with_half_angles(self.tape, self.tape.depending_on(range(sampled)))

    @cached_property
    def _schedules(self) -> dict[tuple[Levels, bool], Schedule]:
        return {}

    def _schedule(self, levels: Levels, *, single: bool) -> Schedule:
        """The schedule for parameters that change at these levels, or for a single set of them."""
        if (levels, single) not in self._schedules:
            self._schedules[levels, single] = Schedule.of(self._evaluated, levels, single=single)
        return self._schedules[levels, single]


def _levels(theta: Array) -> Levels:
    """How often each parameter changes over sets theta (g, k), grouped so that most operations are shared.

    The parameter that changes with each set is the one without which the fewest distinct sets remain.
    """
    sets, count = theta.shape
    if sets == 1:
        return tuple([PER_SET] * count)
    varied = np.flatnonzero((theta != theta[0]).any(axis=0))
    groups = [len(np.unique(theta[:, varied[varied != i]], axis=0)) for i in varied] if len(varied) > 1 else []
    others = PER_GROUP if groups and 2 * min(groups) <= sets else PER_SET
    innermost = int(varied[int(np.argmin(groups))]) if groups else NO_OPERAND
    changing = set(varied.tolist())
    return tuple((PER_SET if i == innermost else others) if i in changing else CONSTANT for i in range(count))


def _order(theta: Array, levels: Levels) -> list[tuple[int, bool]]:
    """The sets ordered by groups, and whether each is the first of its group."""
    grouping = theta[:, [level == PER_GROUP for level in levels]]
    order = np.lexsort(grouping.T)
    first_of_group = np.append(True, (np.diff(grouping[order], axis=0) != 0).any(axis=1))
    return list(zip(map(int, order), map(bool, first_of_group), strict=True))


def _blocks(
    schedule: Schedule,
    fixed: list[Any],
    changing: list[Any],
    outputs: list[Any],
    order: Sequence[tuple[int, bool]],
    dtype: type[float] | type[complex],
    averaged: int,
) -> None:
    """Evaluate the samples block by block, in each the parameter sets in that order; outputs are means over some."""
    samples, sets = outputs[0].shape[0] * averaged, outputs[0].shape[1]
    scalars = [[value[row, ...] if value.ndim else value for value in fixed] for row in range(sets)]
    rows = max(schedule.rows + len(outputs) * (averaged > 1), 1)
    length = min(max(BLOCK_NUMBERS // rows, SHORTEST_BLOCK), LONGEST_BLOCK, samples)
    length = max(length // averaged, 1) * averaged
    unaveraged, weights = (
        np.empty((len(outputs), length if averaged > 1 else 0), dtype),
        np.full(averaged, 1 / averaged),
    )
    work, unset = np.empty((schedule.rows, length), dtype), [None] * len(outputs)
    first_output = len(fixed) + len(changing)
    for start in range(0, samples, length):
        stop = min(start + length, samples)
        values: list[Any] = [*scalars[0], *(column[start:stop] for column in changing), *unset]
        values += list(work[:, : stop - start])
        _execute(schedule.of_signals, values)
        for row, first_of_group in order:
            values[: len(fixed)] = scalars[row]
            if first_of_group:
                _execute(schedule.of_several, values)
            places = [output[start // averaged : stop // averaged, row] for output in outputs]
            values[first_output : first_output + len(outputs)] = (
                places if averaged == 1 else list(unaveraged[:, : stop - start])
            )
            _execute(schedule.of_each, values)
            if averaged > 1:
                parts = unaveraged[:, : stop - start].reshape(len(outputs), -1, averaged)
                for place, means in zip(places, parts @ weights, strict=True):
                    place[:] = means


def _execute(steps: Sequence[Instruction], values: list[Any]) -> None:
    for function, a, b, result in steps:
        if b == NO_OPERAND:
            function(values[a], values[result])
        else:
            function(values[a], values[b], values[result])


@dataclass(frozen=True, eq=False)
class Schedule:
    """The operations of a tape by what they depend on, and slots for their results.

    of_parameters     on parameters and constants alone: each fills the next slot after these
    of_signals        on signals, and parameters that are the same in all sets
    of_several        on signals and parameters, none of which changes with each set
    of_each           on a parameter that changes with each set; and copies of results to the outputs
    constant_results  results of parameters alone that are not identically zero: the output, and the slot of the value
    outputs           the results that differ from sample to sample
    rows              values of samples that are live at the same time

    Slots are, in this order: values common to all samples, the inputs, the outputs, the rows.
    """

    of_parameters: tuple[Instruction, ...]
    of_signals: tuple[Instruction, ...]
    of_several: tuple[Instruction, ...]
    of_each: tuple[Instruction, ...]
    constant_results: tuple[tuple[int, int], ...]
    outputs: tuple[int, ...]
    rows: int

    @classmethod
    def of(cls, tape: Tape, levels: Levels, *, single: bool = False) -> Schedule:
        """The schedule of a tape; no `levels` where the parameters differ from sample to sample.

        With a `single` set all operations are of it.
        """
        inputs = tape.inputs + tape.parameters - len(levels)
        sampled, level = _dependence(tape, inputs, levels, PER_SET if single else CONSTANT)
        common = [number for number in range(inputs, tape.size) if not sampled[number]]
        slots = [NO_OPERAND] * (tape.size + 1)  # the last is that of `NO_OPERAND`
        for slot, number in enumerate((*common, *range(inputs))):
            slots[number] = slot
        zero = {n for n, constant in enumerate(tape.constants, tape.first - len(tape.constants)) if constant == 0}
        outputs = [output for output, number in enumerate(tape.results) if sampled[number]]
        constant = [o for o, n in enumerate(tape.results) if not sampled[n] and n not in zero]
        constant_results = tuple((output, slots[tape.results[output]]) for output in constant)
        copies: dict[int, list[int]] = {}
        for slot, output in enumerate(outputs, start=len(common) + inputs):
            copies.setdefault(tape.results[output], []).append(slot)
        by_level: dict[int | None, list[Numbered]] = {None: [], CONSTANT: [], PER_GROUP: [], PER_SET: []}
        for number, operation in enumerate(tape.operations, start=tape.first):
            by_level[level[number] if sampled[number] else None].append((number, operation))
        fixed = tuple((NUMPY_OPERATIONS[name], slots[a], slots[b], slots[n]) for n, (name, a, b) in by_level[None])
        rows = _RowAllocation(tape, slots, first=len(common) + inputs + len(outputs))
        used_later = {o for when in (PER_GROUP, PER_SET) for _, (_, *operands) in by_level[when] for o in operands}
        used_later |= set(copies)
        of_signals = [rows.step(number, operation, live=used_later) for number, operation in by_level[CONSTANT]]
        used_later = {o for _, (_, *operands) in by_level[PER_SET] for o in operands} | set(copies)
        used_later |= {number for number, _ in by_level[CONSTANT]}
        of_several = [rows.step(number, operation, live=used_later) for number, operation in by_level[PER_GROUP]]
        reused = {number for when in (CONSTANT, PER_GROUP) for number, _ in by_level[when]}
        early = [number for number in copies if number < tape.first or level[number] != PER_SET]
        of_each: list[Instruction] = [
            (np.positive, slots[number], NO_OPERAND, slot) for number in early for slot in copies[number]
        ]
        for number, operation in by_level[PER_SET]:
            places = copies.get(number, [])
            into = places[0] if places and rows.last[number] == NO_OPERAND else None  # not read by another operation
            of_each.append(rows.step(number, operation, live=reused, into=into))
            of_each += [(np.positive, slots[number], NO_OPERAND, slot) for slot in places if slot != into]
        steps = (fixed, tuple(of_signals), tuple(of_several), tuple(of_each))
        return cls(*steps, constant_results, tuple(outputs), rows.count)


def _dependence(tape: Tape, inputs: int, levels: Levels, least: int) -> tuple[list[bool], list[int]]:
    """Whether each value differs from sample to sample, and at which level, the `least` or above, it changes."""
    constants = len(tape.constants)
    sampled = [True] * inputs + [False] * (len(levels) + constants)
    level = [least] * inputs + [*levels] + [CONSTANT] * constants
    for _, a, b in tape.operations:
        sampled.append(sampled[a] or (b != NO_OPERAND and sampled[b]))
        level.append(level[a] if b == NO_OPERAND else max(level[a], level[b]))
    return sampled, level


class _RowAllocation:
    """Rows for values of samples, freed at the last operation that reads a value."""

    def __init__(self, tape: Tape, slots: list[int], first: int) -> None:
        self.slots, self.first = slots, first
        self.count = 0
        self.free: list[int] = []
        self.last = [NO_OPERAND] * len(slots)
        for number, (_, a, b) in enumerate(tape.operations, start=tape.first):
            self.last[a] = self.last[b] = number

    def step(self, number: int, operation: Operation, live: Collection[int], into: int | None = None) -> Instruction:
        """The instruction of a value; its row may be that of an operand read last here, unless that stays live.

        No row is taken for a value that is written `into` an output.
        """
        slots, last, free = self.slots, self.last, self.free
        name, a, b = operation
        left, right = slots[a], slots[b]
        if last[a] == number and left >= self.first and a not in live:
            free.append(left)
        if b != a and last[b] == number and right >= self.first and b not in live:
            free.append(right)
        if into is None and not free:
            free.append(self.first + self.count)
            self.count += 1
        slots[number] = result = free.pop() if into is None else into
        return NUMPY_OPERATIONS[name], left, right, result


# Partial evaluation: a tape with some parameters fixed, constants folded, in canonical order.


TapeOperand = float | int
"""A constant, or the number of a value that is not constant."""


def partially_evaluated(tape: Tape, fixed: Mapping[int, float]) -> Tape:
    """The tape with the parameters in `fixed` at these values; their number k stays.

    A product with zero is zero, even of what is not finite. Operations come depth first from the results, without dead
    code: equal derivations give equal tapes.
    """
    numbers = {tape.inputs + parameter: value for parameter, value in fixed.items()}
    values: list[TapeOperand] = [float(numbers[n]) if n in numbers else n for n in range(tape.inputs + tape.parameters)]
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
    result = np.empty(())
    with np.errstate(all="ignore"):
        NUMPY_OPERATIONS[name](*map(np.array, operands), result)
    return float(result)


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
        operations = Operations.of((name, number(a), number(b)) for name, a, b in ordered)
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
