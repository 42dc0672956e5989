"""Program of one sample, in SymPy expressions: what every stage with memory does from sample to sample.

A program is a list of statements over named values: assignments, initialised values, delay lines, and equations solved
by Newton's method. CasADi, C and Python read the same list (`modeling.codegen`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import (
    Definitions,
    OperationCount,
    StraightLineProgram,
    forward_derivative,
    required_definitions,
)

Symbols: TypeAlias = "tuple[sp.Symbol, ...]"
Expressions: TypeAlias = "Sequence[sp.Expr]"

NEWTON_STEPS = 8
"""Newton steps per sample, each doubling the correct digits: four suffice from sample to sample, seven from 0 to 1 rad.

A fixed number, so that every sample takes the same time."""

INITIAL_STATE_SHARE = 1e-3
"""Fraction of a wrong initial state left when the transient counts as settled: 0.1 N of a load of 100 N."""


@dataclass(frozen=True, eq=False)
class Assignments:
    """`symbols` are the results of a program; `about` says what they are."""

    symbols: Symbols
    program: StraightLineProgram
    about: str = ""

    @property
    def reads(self) -> set[sp.Symbol]:
        """The values that it needs."""
        return self.program.shared.free_symbols


@dataclass(frozen=True, eq=False)
class InitialisedValues:
    """`symbols` are `first` at the first sample (the steady state under it), and `later` at all others."""

    symbols: Symbols
    first: tuple[sp.Expr, ...]
    later: tuple[sp.Expr, ...]

    @property
    def reads(self) -> set[sp.Symbol]:
        """The values that it needs."""
        return {symbol for expression in (*self.first, *self.later) for symbol in expression.free_symbols}


@dataclass(frozen=True, eq=False)
class DelayLine:
    """`values` (c,) are stored; `symbols` are those of `ages` samples ago (0 is now), c of each age, age by age.

    Before the first sample the line is full of that sample's values.
    """

    symbols: Symbols
    name: str
    values: Symbols
    ages: tuple[int, ...]

    @property
    def reads(self) -> set[sp.Symbol]:
        """The values that it needs."""
        return set(self.values)

    @property
    def length(self) -> int:
        """Stored vectors, the present one included."""
        return 1 + max(self.ages)

    @property
    def taps(self) -> list[tuple[sp.Symbol, int, int]]:
        """Each symbol with its age and its component."""
        places = [(age, i) for age in self.ages for i in range(len(self.values))]
        return [(symbol, *place) for symbol, place in zip(self.symbols, places, strict=True)]


@dataclass(frozen=True, eq=False)
class NewtonSolution:
    """`symbols` (d,) solve an equation by `steps` steps of Newton's method from `start` (d,).

    program   the residual (d,), then its Jacobian (d, d) row by row, of `symbols` and of earlier values
    """

    symbols: Symbols
    start: tuple[sp.Expr, ...]
    program: StraightLineProgram
    steps: int = NEWTON_STEPS
    about: str = ""

    @property
    def reads(self) -> set[sp.Symbol]:
        """The values that it needs."""
        start = {symbol for expression in self.start for symbol in expression.free_symbols}
        return (start | self.program.shared.free_symbols) - set(self.symbols)


Statement: TypeAlias = "Assignments | InitialisedValues | DelayLine | NewtonSolution"


@dataclass(frozen=True, eq=False)
class SampleProgram:
    """The statements of one sample, its result (p,), and the states with their values after it.

    latency   samples by which the result lags the inputs
    settling  first results that depend on the initial state
    alignment  of measured readings (p,) with the result; None without a latency
    """

    statements: tuple[Statement, ...]
    result: Symbols
    states: Symbols
    following: Symbols
    latency: int
    settling: int
    alignment: DelayLine | None

    @property
    def delay_lines(self) -> list[DelayLine]:
        """The delay lines, that of the readings last."""
        lines = [s for s in self.statements if isinstance(s, DelayLine)]
        return lines if self.alignment is None else [*lines, self.alignment]

    @cached_property
    def free_symbols(self) -> set[sp.Symbol]:
        """The signals and parameters that a sample takes."""
        computed = {*self.states, *(symbol for s in self.statements for symbol in s.symbols)}
        return {symbol for s in self.statements for symbol in s.reads} - computed

    @property
    def unused(self) -> list[sp.Symbol]:
        """Values that nothing reads."""
        read = {*self.result, *self.following, *(symbol for s in self.statements for symbol in s.reads)}
        return [symbol for s in self.statements for symbol in s.symbols if symbol not in read]

    def operations(self, *, shared: bool) -> OperationCount:
        """Operations of one sample, with common subexpressions shared or without."""
        total = OperationCount()
        for s in self.statements:
            if isinstance(s, Assignments | NewtonSolution):
                count = s.program.shared.operations if shared else s.program.operations_unshared
                total = OperationCount.sum([total, *[count] * (s.steps if isinstance(s, NewtonSolution) else 1)])
        return total


class SampleProgramBuilder:
    """Collects the statements of one sample at the parameters `values` and the sampling interval `dt` (s).

    Expressions may hold signals, parameters, values of earlier statements and the variables of `definitions`.
    """

    def __init__(self, values: Mapping[sp.Symbol, float], dt: float, definitions: Definitions = ()) -> None:
        self.values, self.dt, self._definitions = values, dt, definitions
        self.latency = self.settling = 0
        self._statements: list[Statement] = []
        self._names: dict[str, int] = {}
        self._following: dict[sp.Symbol, sp.Expr] = {}

    def assigned(self, name: str, expressions: Expressions, about: str = "") -> Symbols:
        """New values of that name."""
        symbols = self._new(name, len(expressions))
        self.define(symbols, expressions, about)
        return symbols

    def define(self, symbols: Symbols, expressions: Expressions, about: str = "") -> None:
        """Values under given symbols, those of signals that are computed here."""
        self._statements.append(Assignments(symbols, self._program(expressions), about))

    def initialised(self, name: str, first: Expressions, later: Expressions) -> Symbols:
        """Values that are `first` at the first sample, and `later` at all others."""
        symbols = self._new(name, len(first))
        self._statements.append(InitialisedValues(symbols, tuple(first), tuple(later)))
        return symbols

    def state(self, name: str, first: Expressions) -> Symbols:
        """Values kept from the sample before, see `keep`; `first` at the first sample."""
        return self.initialised(name, first, self._new(f"{name}_kept", len(first)))

    def keep(self, state: Symbols, following: Expressions) -> None:
        """Set what a `state` will be at the next sample."""
        (kept,) = (s.later for s in self._statements if isinstance(s, InitialisedValues) and s.symbols == state)
        self._following |= dict(zip(kept, following, strict=True))

    def delayed(self, name: str, values: Symbols, ages: Iterable[int]) -> list[Symbols]:
        """The values of `ages` samples ago, for each age."""
        ages, size = tuple(ages), len(values)
        symbols = self._new(name, len(ages) * size)
        self._statements.append(DelayLine(symbols, f"{name}_{self._names[name]}", values, ages))
        return [symbols[i : i + size] for i in range(0, len(symbols), size)]

    def aligned(self, name: str, values: Symbols) -> Symbols:
        """Values of present signals, delayed by the latency of the stages so far."""
        return self.delayed(name, values, (self.latency,))[0] if self.latency and values else values

    def solved(
        self,
        name: str,
        start: Expressions,
        equation: Expressions,
        given: Callable[[Symbols], Definitions],
        *,
        steps: int = NEWTON_STEPS,
        about: str = "",
    ) -> Symbols:
        """Unknowns by Newton's method from `start`, of an equation in variables that are `given` by the unknowns."""
        unknowns, program = self._new(name, len(start)), self._program(equation)
        residual = StraightLineProgram.of(program.results, (*given(unknowns), *program.steps)).shared
        jacobian = forward_derivative(residual, unknowns)
        both = StraightLineProgram.of([*residual.results, *jacobian.results], jacobian.steps)
        self._statements.append(NewtonSolution(unknowns, tuple(start), both, steps, about))
        return unknowns

    def finished(self, result: Symbols) -> SampleProgram:
        """The program with that result."""
        states, alignment = tuple(self._following), None
        following = self.assigned("next", list(self._following.values())) if states else ()
        if self.latency:
            readings = self._new("reading", len(result))
            alignment = DelayLine(self._new("measured", len(result)), "readings", readings, (self.latency,))
        statements = tuple(self._statements)
        return SampleProgram(statements, result, states, following, self.latency, self.settling, alignment)

    def _program(self, expressions: Expressions) -> StraightLineProgram:
        return StraightLineProgram.of(
            expressions, required_definitions(self._definitions, sp.Matrix(list(expressions)))
        )

    def _new(self, name: str, count: int) -> Symbols:
        """Symbols that no signal, parameter or other statement has."""
        number = self._names[name] = self._names.get(name, -1) + 1
        return tuple(sp.Symbol(f"sample:{name}_{number}_{i}", real=True) for i in range(count))
