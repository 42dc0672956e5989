"""The program of a sample as a CasADi graph, and its evaluation sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.dynamics.sample_program import (
    Assignments,
    DelayLine,
    InitialisedValues,
    NewtonSolution,
    SampleProgram,
)
from modeling.expressions.compilation import casadi_results
from modeling.expressions.straight_line_program import StraightLineProgram

Array = NDArray[np.float64]


def state_size(program: SampleProgram) -> int:
    """Length of the state vector: 1 after the first sample, the states, then the delay lines, newest first.

    0 for a program without memory.
    """
    count = len(program.states) + sum((line.length - 1) * len(line.values) for line in program.delay_lines)
    return 1 + count if count else 0


@dataclass(frozen=True, eq=False)
class CasadiSample:
    """Graphs of one sample: the prediction (p,), the reading (p,) of the same sample, and the next state."""

    prediction: Any
    measured: Any
    next_state: Any

    @classmethod
    def of(cls, program: SampleProgram, values: Mapping[sp.Symbol, Any], reading: Any, state: Any) -> CasadiSample:
        """The sample for graphs of the signals and parameters, of the reading (p,) and of the state."""
        import casadi as ca

        run, line = _Execution(program, values, state), program.alignment
        for statement in program.statements:
            run.execute(statement)
        if line is not None:
            run.known |= dict(zip(line.values, ca.vertsplit(reading), strict=True))
            run.execute(line)
        measured = reading if line is None else run.vector(line.symbols)
        memory = [1, run.vector(program.following), *run.stored] if state_size(program) else []
        return cls(run.vector(program.result), measured, ca.vertcat(ca.SX(0, 1), *memory))


class _Execution:
    """Values of all symbols so far, the parts of the state that are not read yet, and what the delay lines store."""

    def __init__(self, program: SampleProgram, values: Mapping[sp.Symbol, Any], state: Any) -> None:
        import casadi as ca

        started, *kept = ca.vertsplit(state) if state.numel() else [1]
        self._started, self._state, self.stored = started, iter(kept), list[Any]()
        self.known = {**values, **dict(zip(program.states, self._state, strict=False))}

    def vector(self, symbols: tuple[sp.Symbol, ...]) -> Any:
        """Their values as one vector."""
        import casadi as ca

        return ca.vertcat(*(self.known[symbol] for symbol in symbols))

    def execute(self, statement: Any) -> None:
        """Add the values of a statement."""
        if isinstance(statement, Assignments):
            values = casadi_results(statement.program.shared, self.known)
        elif isinstance(statement, InitialisedValues):
            values = self._initialised(statement)
        else:
            values = self._delayed(statement) if isinstance(statement, DelayLine) else self._solved(statement)
        self.known |= dict(zip(statement.symbols, values, strict=True))

    def _initialised(self, statement: InitialisedValues) -> list[Any]:
        import casadi as ca

        pairs = zip(self._graphs(statement.first), self._graphs(statement.later), strict=True)
        return [ca.if_else(self._started, later, first) for first, later in pairs]

    def _graphs(self, expressions: tuple[sp.Expr, ...]) -> list[Any]:
        return casadi_results(StraightLineProgram.of(expressions), self.known)

    def _delayed(self, line: DelayLine) -> list[Any]:
        import casadi as ca

        stored, width = [self.known[symbol] for symbol in line.values], len(line.values)
        for i in range((line.length - 1) * width):
            stored.append(ca.if_else(self._started, next(self._state), stored[i % width]))
        self.stored += stored[: len(stored) - width]
        return [stored[width * age + component] for _, age, component in line.taps]

    def _solved(self, statement: NewtonSolution) -> list[Any]:
        import casadi as ca

        size, program = len(statement.symbols), statement.program.shared
        unknowns = ca.vertcat(*self._graphs(statement.start))
        for _ in range(statement.steps):
            at = self.known | dict(zip(statement.symbols, ca.vertsplit(unknowns), strict=True))
            found = ca.vertcat(*casadi_results(program, at))
            unknowns -= ca.solve(ca.reshape(found[size:], size, size).T, found[:size])
        return list(ca.vertsplit(unknowns))


class RecursiveFunction:
    """A CasADi function (inputs .., state) -> (results .., next state), evaluated sample by sample from state zero."""

    def __init__(self, function: Any) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._results = [np.zeros(function.size1_out(i)) for i in range(function.n_out())]
        self._state = np.zeros(function.size1_in(function.n_in() - 1))

    def __call__(self, *inputs: Array) -> list[Array]:
        """The results for the inputs, contiguous arrays; the state advances."""
        # Set at every call: the buffer holds no reference to its arguments.
        for place, argument in enumerate((*inputs, self._state)):
            if argument.size:
                self._buffer.set_arg(place, memoryview(argument))  # type: ignore[arg-type]
        for place, result in enumerate(self._results):
            if result.size:
                self._buffer.set_res(place, memoryview(result))  # type: ignore[arg-type]
        self._evaluate()
        self._state[:] = self._results[-1]
        return [result.copy() for result in self._results[:-1]]
