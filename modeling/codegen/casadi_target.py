"""CasADi target: the rigid tool's regressor, or a fitted model, as a CasADi function of one sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.codegen.code_target import CodeTarget
from modeling.codegen.expression_text import identifiers
from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
from modeling.compiled.straight_line_program import StraightLineProgram
from modeling.compiled.symbolic_vector import casadi_results
from modeling.dynamics.sample_program import Assignments, DelayLine, InitialisedValues, NewtonSolution, SampleProgram
from modeling.space import signals

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
        run, line = _Execution(program, values, state), program.alignment
        for statement in program.statements:
            run.execute(statement)
        if line is not None:
            run.graphs |= dict(zip(line.values, ca.vertsplit(reading), strict=True))
            run.execute(line)
        measured = reading if line is None else run.vector(line.symbols)
        memory = [1, run.vector(program.following), *run.stored] if state_size(program) else []
        return cls(run.vector(program.result), measured, ca.vertcat(ca.SX(0, 1), *memory))


class _Execution:
    """Values of all symbols so far, the parts of the state that are not read yet, and what the delay lines store."""

    def __init__(self, program: SampleProgram, values: Mapping[sp.Symbol, Any], state: Any) -> None:
        started, *kept = ca.vertsplit(state) if state.numel() else [1]
        self._started, self._state, self.stored = started, iter(kept), list[Any]()
        self.graphs = {**values, **dict(zip(program.states, self._state, strict=False))}

    def vector(self, symbols: tuple[sp.Symbol, ...]) -> Any:
        """Their values as one vector."""
        return ca.vertcat(*(self.graphs[symbol] for symbol in symbols))

    def execute(self, statement: Any) -> None:
        """Add the values of a statement."""
        if isinstance(statement, Assignments):
            values = casadi_results(statement.program.shared, self.graphs)
        elif isinstance(statement, InitialisedValues):
            values = self._initialised(statement)
        else:
            values = self._delayed(statement) if isinstance(statement, DelayLine) else self._solved(statement)
        self.graphs |= dict(zip(statement.symbols, values, strict=True))

    def _initialised(self, statement: InitialisedValues) -> list[Any]:
        pairs = zip(self._graphs(statement.first), self._graphs(statement.later), strict=True)
        return [ca.if_else(self._started, later, first) for first, later in pairs]

    def _graphs(self, expressions: tuple[sp.Expr, ...]) -> list[Any]:
        return casadi_results(StraightLineProgram.of(expressions), self.graphs)

    def _delayed(self, line: DelayLine) -> list[Any]:
        stored, width = [self.graphs[symbol] for symbol in line.values], len(line.values)
        for i in range((line.length - 1) * width):
            stored.append(ca.if_else(self._started, next(self._state), stored[i % width]))
        self.stored += stored[: len(stored) - width]
        return [stored[width * age + component] for _, age, component in line.taps]

    def _solved(self, statement: NewtonSolution) -> list[Any]:
        size, program = len(statement.symbols), statement.program.shared
        unknowns = ca.vertcat(*self._graphs(statement.start))
        for _ in range(statement.steps):
            at = self.graphs | dict(zip(statement.symbols, ca.vertsplit(unknowns), strict=True))
            results = ca.vertcat(*casadi_results(program, at))
            unknowns -= ca.solve(ca.reshape(results[size:], size, size).T, results[:size])
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


class CasadiTarget(CodeTarget):
    """CasADi functions, serialised: `casadi.Function.deserialize(text)`."""

    name = "casadi"
    suffix = ".casadi"

    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """The function of `casadi_regressor`."""
        return str(casadi_regressor(base).serialize())

    def model(self, fitted: FittedModel, source: str) -> str:
        """The function of `casadi_model`."""
        return str(casadi_model(fitted).serialize())


RESERVED_INPUTS = ("reading", "change", "state")
SymbolValues: TypeAlias = "dict[sp.Symbol, Any]"


def casadi_model(fitted: FittedModel) -> Any:
    """A fitted model as the CasADi function `model` of one sample.

    Inputs: each signal by its name; `reading` (p,); `change` (k,), added to the estimated parameters; `state`: zeros
    at the start, then the last `next_state`. An input that is not given is zero. Outputs: `prediction` and `contact`
    (p,) of that sample, or of `wait` samples ago where readings lead the motion; `next_state`; and, where it exists
    (`FittedModel.sensitivity`), the derivative of load + bias in the parameters (p, k), `regressor` or `sensitivity`.
    """
    names, state = input_names(fitted), ca.SX.sym("state", state_size(fitted.program))
    inputs = [ca.SX.sym(name) for name in names]
    reading, change = ca.SX.sym("reading", fitted.size), ca.SX.sym("change", len(fitted.parameters))
    values: SymbolValues = dict(zip(signals(*fitted.inputs), inputs, strict=True))
    for i, parameter in enumerate(fitted.parameters):
        values[parameter.symbol] = fitted.values[parameter.name] + change[i]
    sample = CasadiSample.of(fitted.program, values, reading, state)
    values |= dict(zip(fitted.residual, ca.vertsplit(sample.measured - sample.prediction), strict=True))
    contact = CasadiSample.of(fitted.contact, values, reading, ca.SX(0, 1))
    results = {"prediction": sample.prediction, "contact": contact.prediction, "next_state": sample.next_state}
    if fitted.sensitivity is not None:
        elements = ca.vertcat(*casadi_results(fitted.sensitivity.shared, values))
        results[fitted.derivative_name] = ca.reshape(elements, len(fitted.parameters), fitted.size).T
    graphs = [ca.densify(graph) for graph in results.values()]
    return ca.Function("model", [*inputs, reading, change, state], graphs, [*names, *RESERVED_INPUTS], list(results))


def input_names(fitted: FittedModel) -> list[str]:
    """The signals' names, prefixed with u_ where CasADi does not allow the name or it is reserved."""

    def allowed(name: str) -> bool:
        return bool(ca.Function.check_name(name)) and name not in RESERVED_INPUTS

    prefixed = identifiers(fitted.inputs, "u_")
    return [name if allowed(name) else other for name, other in zip(fitted.inputs, prefixed, strict=True)]


def casadi_regressor(base: RigidToolRegressor) -> Any:
    """The CasADi function `regressor` of one sample: inputs by name as in FORMATS, output `Phi` (p, k)."""
    arguments = {name: ca.SX.sym(name, len(components)) for name, components in base.arguments.items()}
    scalars = [scalar for argument in arguments.values() for scalar in ca.vertsplit(argument)]
    elements = casadi_results(base.program.shared, dict(zip(signals(*base.inputs), scalars, strict=True)))
    columns = base.matrix.shape[1]
    Phi = ca.reshape(ca.vertcat(*elements), columns, -1).T
    return ca.Function("regressor", list(arguments.values()), [ca.densify(Phi)], list(arguments), ["Phi"])
