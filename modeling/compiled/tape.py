"""Wengert list of a compiled expression, as plain data (Griewank and Walther, Evaluating Derivatives, 2.2).

Each elementary operation takes earlier values and gives one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.compiled.symbolic_vector import casadi_expressions

Numbers = NDArray[np.int32]
Operation = tuple[str, int, int]

NO_OPERAND = -1
"""The second operand of a unary operation."""

UNARY = (
    *("neg", "sq", "twice", "inv", "sqrt", "exp", "expm1", "log", "log1p", "sign", "fabs", "not"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
)
BINARY = (
    *("add", "sub", "mul", "div", "pow", "constpow", "fmin", "fmax", "atan2"),
    *("lt", "le", "eq", "ne", "and", "or", "if_else_zero"),
)
"""Operations by CasADi's names (OP_ADD is add); comparisons give 1 or 0, if_else_zero(c, x) is x where c is not 0."""
IS_UNARY = {**dict.fromkeys(UNARY, True), **dict.fromkeys(BINARY, False)}
"""Whether an operation has one operand."""

NAMES = UNARY + BINARY
CODES = {name: code for code, name in enumerate(NAMES)}


@dataclass(frozen=True, eq=False)
class Operations:
    """Operations in columns: numbers of names, of first and of second operands, 9 bytes for each operation.

    As tuples they took 130: a diagnosis of an arm's joint log, which holds two million, took 840 MB instead of 520.
    """

    codes: bytes
    left: Numbers
    right: Numbers

    @classmethod
    def of(cls, operations: Iterable[Operation]) -> Self:
        """Of tuples."""
        names, left, right = list(zip(*operations, strict=True)) or ((), (), ())
        return cls(bytes(map(CODES.__getitem__, names)), np.array(left, np.int32), np.array(right, np.int32))

    def at(self, places: NDArray[np.intp]) -> Operations:
        """Those at these places."""
        codes = np.frombuffer(self.codes, np.uint8)[places].tobytes()
        return Operations(codes, self.left[places], self.right[places])

    def operands_of(self, name: str) -> set[int]:
        """First operands of all operations of a name."""
        return set(self.left[np.frombuffer(self.codes, np.uint8) == CODES[name]].tolist())

    def renumbered(self, numbers: Sequence[int] | NDArray[np.intp]) -> Operations:
        """With other numbers of their operands; the last of `numbers` is `NO_OPERAND`."""
        table = np.asarray(numbers, np.int32)
        return Operations(self.codes, table[self.left], table[self.right])

    def __len__(self) -> int:
        return len(self.codes)

    def __iter__(self) -> Iterator[Operation]:
        return zip(map(NAMES.__getitem__, self.codes), self.left.tolist(), self.right.tolist(), strict=True)

    def __getitem__(self, place: int) -> Operation:
        return NAMES[self.codes[place]], int(self.left[place]), int(self.right[place])


@dataclass(frozen=True, eq=False)
class Tape:
    """Values are numbered: the inputs u (m), the parameters theta (k), the constants, then one for each operation.

    operations  names with the numbers of their one or two operands
    results     the numbers of the results
    """

    inputs: int
    parameters: int
    constants: tuple[float, ...]
    operations: Operations
    results: tuple[int, ...]

    @classmethod
    def of(cls, u: Any, theta: Any, results: Any) -> Self:
        """The tape of a CasADi vector over symbols u (m,) and theta (k,), common subexpressions shared.

        Raises ValueError for an operation outside UNARY and BINARY.
        """
        function = ca.Function("tape", [u, theta], [ca.densify(ca.cse(ca.vec(results)))])
        return cls(u.numel(), theta.numel(), *_recorded(function))

    @classmethod
    def of_expressions(cls, inputs: Sequence[sp.Symbol], expressions: Sequence[sp.Expr]) -> Self:
        """The tape of SymPy expressions of these inputs, without parameters.

        Raises InputError for a function without counterpart in CasADi.
        """
        u = ca.SX.sym("u", len(inputs))
        results = casadi_expressions(dict(zip(inputs, ca.vertsplit(u), strict=True)), expressions)
        return cls.of(u, ca.SX(0, 1), ca.vertcat(ca.SX(0, 1), *results))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """The tape from the result of `to_data`.

        Raises ValueError for invalid data: unknown operations, operands that are not earlier values.
        """
        m, k = _count(data["inputs"]), _count(data["parameters"])
        constants = tuple(map(float, data["constants"]))
        names, left, right = data["operations"]
        results, first = tuple(data["results"]), m + k + len(constants)
        if not len(names) == len(left) == len(right):
            raise ValueError("the columns of operations are not of one length")
        if {*map(type, left), *map(type, right), *map(type, results)} - {int} or not IS_UNARY.keys() >= {*names}:
            raise ValueError("an operation is not a known name with integer operands")
        a, b, number = np.array(left), np.array(right), np.arange(first, first + len(names))
        unary = np.array([IS_UNARY[name] for name in names], dtype=bool)
        valid = (a >= 0) & (a < number) & np.where(unary, b == NO_OPERAND, (b >= 0) & (b < number))
        if not valid.all():
            wrong = int(np.argmin(valid))
            raise ValueError(f"operation {first + wrong} has invalid operands: {left[wrong]}, {right[wrong]}")
        if not all(0 <= result < first + len(names) for result in results):
            raise ValueError("a result is not the number of a value")
        codes = bytes(map(CODES.__getitem__, names))
        return cls(m, k, constants, Operations(codes, a.astype(np.int32), b.astype(np.int32)), results)

    def to_data(self) -> dict[str, Any]:
        """Lists of names and numbers."""
        return {
            "inputs": self.inputs,
            "parameters": self.parameters,
            "constants": list(self.constants),
            "operations": [list(column) for column in zip(*self.operations, strict=True)] or [[], [], []],
            "results": list(self.results),
        }

    @cached_property
    def first(self) -> int:
        """The number of the first operation's value."""
        return self.inputs + self.parameters + len(self.constants)

    @property
    def size(self) -> int:
        """The number of values."""
        return self.first + len(self.operations)

    def depending_on(self, inputs: Sequence[int]) -> set[int]:
        """The numbers of all values that depend on any of these inputs."""
        dependent = set(inputs)
        for number, (_, a, b) in enumerate(self.operations, start=self.first):
            if a in dependent or b in dependent:
                dependent.add(number)
        return dependent

    def among_parameters(self, places: Sequence[int], count: int) -> Tape:
        """The tape with its parameters at these places among `count` of them."""
        m, added = self.inputs, count - self.parameters
        renumbered = [*range(m), *(m + place for place in places), *range(m + count, self.size + added), NO_OPERAND]
        operations = self.operations.renumbered(renumbered)
        return Tape(m, count, self.constants, operations, tuple(renumbered[r] for r in self.results))

    def with_inputs(self, parameters: Sequence[int]) -> Tape:
        """The tape with some of the parameters as further inputs, in that order."""
        m, chosen = self.inputs, list(parameters)
        others = sorted({*range(self.parameters)} - {*chosen})
        order = [*range(m), *(m + i for i in chosen), *(m + i for i in others)]
        renumbered = [*range(self.size), NO_OPERAND]
        for new, old in enumerate(order):
            renumbered[old] = new
        results, operations = tuple(renumbered[r] for r in self.results), self.operations.renumbered(renumbered)
        return Tape(m + len(chosen), len(others), self.constants, operations, results)

    def only(self, results: Sequence[int]) -> Tape:
        """The tape of some of the results, by their indices, without operations that they do not need."""
        wanted = [self.results[index] for index in results]
        used = bytearray(self.size + 1)  # the last is that of `NO_OPERAND`
        for number in wanted:
            used[number] = True
        left, right, first = self.operations.left.tolist(), self.operations.right.tolist(), self.first
        for place in range(len(left) - 1, -1, -1):
            if used[first + place]:
                used[left[place]] = used[right[place]] = True
        kept = np.flatnonzero(np.frombuffer(used, np.uint8)[first : self.size])
        renumbered = np.full(self.size + 1, NO_OPERAND)
        renumbered[:first], renumbered[first + kept] = np.arange(first), first + np.arange(len(kept))
        operations = self.operations.at(kept).renumbered(renumbered)
        return Tape(self.inputs, self.parameters, self.constants, operations, tuple(renumbered[wanted].tolist()))

    def graph(self, u: Any, theta: Any) -> Any:
        """The results as a dense CasADi vector over vectors u (m,) and theta (k,)."""
        values = [u[i] for i in range(self.inputs)] + [theta[i] for i in range(self.parameters)]
        values += [ca.SX(constant) for constant in self.constants]
        codes = _codes()
        for name, a, b in self.operations:
            left = values[a]
            values.append(
                ca.SX.unary(codes[name], left) if b == NO_OPERAND else ca.SX.binary(codes[name], left, values[b])
            )
        return ca.densify(ca.vertcat(ca.SX(0, 1), *(values[result] for result in self.results)))


def _count(value: object) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is not a count")
    return value


@lru_cache(maxsize=1)
def _codes() -> dict[str, int]:
    """CasADi's code of each operation."""
    return {name: getattr(ca, f"OP_{name.upper()}") for name in UNARY + BINARY}


def _recorded(function: Any) -> tuple[tuple[float, ...], Operations, tuple[int, ...]]:
    """Constants, operations and results of a CasADi function of (u, theta), each value numbered once.

    CasADi reuses work registers; `register` maps each to the number of its present value.
    """
    names = {code: name for name, code in _codes().items()}
    steps = range(function.n_instructions())
    kinds = [function.instruction_id(step) for step in steps]
    literals = [function.instruction_constant(s) for s in steps if kinds[s] == ca.OP_CONST]
    constants = tuple(dict.fromkeys(literals))
    m = function.size1_in(0)
    first = m + function.size1_in(1)
    number_of = {constant: first + i for i, constant in enumerate(constants)}
    register: dict[int, int] = {}
    operations: list[Operation] = []
    results = [NO_OPERAND] * function.size1_out(0)
    for step, kind in zip(steps, kinds, strict=True):
        read, written = function.instruction_input(step), function.instruction_output(step)
        if kind == ca.OP_OUTPUT:
            results[written[1]] = register[read[0]]
        elif kind == ca.OP_INPUT:
            register[written[0]] = m * read[0] + read[1]
        elif kind == ca.OP_CONST:
            register[written[0]] = number_of[function.instruction_constant(step)]
        elif kind in names:
            left, right = (*(register[i] for i in read), NO_OPERAND)[:2]
            register[written[0]] = first + len(constants) + len(operations)
            operations.append((names[kind], left, right))
        else:
            raise ValueError(f"CasADi's operation {kind} is not supported on a tape")
    return constants, Operations.of(operations), tuple(results)
