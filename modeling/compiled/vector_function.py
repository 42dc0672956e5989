"""A vector function of signals and parameters with its parameter derivatives."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import Definitions
from modeling.compiled.symbolic_vector import SymbolicVector
from modeling.compiled.tape import NO_OPERAND, Tape
from modeling.compiled.tape_evaluation import TapeEvaluation, partially_evaluated
from modeling.errors import InputError

Array = NDArray[np.float64]
Signals = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class CompiledVector:
    """A vector (p,) over `inputs` and parameters (k,), then its Jacobian in the `active` ones, column by column."""

    inputs: tuple[str, ...]
    active: tuple[int, ...]
    tape: Tape

    @property
    def rows(self) -> int:
        """The number p."""
        return len(self.tape.results) // (1 + len(self.active))

    @classmethod
    def of(cls, vector: SymbolicVector) -> Self:
        """Compile a symbolic vector."""
        u, theta = ca.SX.sym("u", len(vector.inputs)), ca.SX.sym("theta", len(vector.parameters))
        graph = vector.graph(u, theta)
        jacobian = ca.densify(ca.jacobian(graph, theta)[:, list(vector.active)])
        return cls(vector.inputs, vector.active, Tape.of(u, theta, ca.vertcat(graph, ca.vec(jacobian))))

    def among_parameters(self, places: Sequence[int], count: int) -> CompiledVector:
        """The vector with its parameters at these places, which ascend, among `count` of them."""
        tape = self.tape.among_parameters(places, count)
        return CompiledVector(self.inputs, tuple(places[i] for i in self.active), tape)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """From the result of `to_data`; ValueError, KeyError or TypeError for invalid data."""
        tape, active, inputs = Tape.from_data(data["tape"]), tuple(data["active"]), tuple(data["inputs"])
        consistent = len(inputs) == tape.inputs and all(type(i) is int and 0 <= i < tape.parameters for i in active)
        if not consistent or len(tape.results) % (1 + len(active)):
            raise ValueError("the tape does not match its inputs and parameters")
        return cls(inputs, active, tape)

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {"inputs": list(self.inputs), "active": list(self.active), "tape": self.tape.to_data()}


@dataclass(frozen=True, eq=False)
class VectorFunction:
    """A vector (p,) as a function of signals and parameters (k,).

    inputs    names of the signals
    names     of the k parameters
    active    which parameters it depends on
    symbolic  returns its SymPy expressions, `compile` its tape, each called when first needed
    """

    inputs: tuple[str, ...]
    names: tuple[str, ...]
    active: tuple[int, ...]
    symbolic: Callable[[], SymbolicVector]
    compile: Callable[[], CompiledVector]

    @classmethod
    def of(
        cls,
        expression: sp.Matrix,
        inputs: tuple[str, ...],
        parameters: tuple[sp.Symbol, ...],
        definitions: Definitions = (),
    ) -> Self:
        """Of symbolic expressions; `definitions` are their intermediate variables, in order."""
        vector = SymbolicVector(expression, inputs, parameters, definitions)
        return cls(inputs, vector.names, vector.active, lambda: vector, lambda: CompiledVector.of(vector))

    @property
    def count(self) -> int:
        """The number k of parameters."""
        return len(self.names)

    @property
    def expression(self) -> sp.Matrix:
        """The SymPy expressions."""
        return self.symbolic().expression

    @property
    def parameters(self) -> tuple[sp.Symbol, ...]:
        """The parameters' symbols."""
        return self.symbolic().parameters

    @property
    def definitions(self) -> Definitions:
        """The intermediate variables of the expression."""
        return self.symbolic().definitions

    @cached_property
    def compiled(self) -> CompiledVector:
        """The vector and its derivatives on one tape."""
        return self.compile()

    @property
    def rows(self) -> int:
        """The number p."""
        return self.compiled.rows

    @cached_property
    def symbols(self) -> tuple[Any, Any]:
        """CasADi symbols of the inputs and of the parameters."""
        return ca.SX.sym("u", len(self.inputs)), ca.SX.sym("theta", self.count)

    @cached_property
    def graph(self) -> Any:
        """The vector (p,) as a CasADi graph over `symbols`."""
        return self.compiled.tape.only(range(self.rows)).graph(*self.symbols)

    def columns(self, signals: Signals, samples: int) -> list[Array]:
        """The inputs of the first samples, (samples,) each."""
        for name in self.inputs:
            if name not in signals:
                raise InputError(
                    what=f"the model needs the signal '{name}'",
                    where="recording",
                    remedy="record it, or leave the effect out",
                )
        return [np.asarray(signals[name], dtype=float)[:samples] for name in self.inputs]

    def samples(self, signals: Signals, samples: int) -> Array:
        """The inputs of the first samples, (samples, m)."""
        columns = self.columns(signals, samples)
        return np.stack(columns, axis=1) if columns else np.zeros((samples, 0))

    def value(self, signals: Signals, theta: Array, samples: int) -> Array:
        """Value (samples, p), at parameters (k,) or at different ones for each sample (samples, k)."""
        return self.tangent_in(signals, theta, (), samples)[0]

    def tangent(self, signals: Signals, theta: Array, samples: int) -> tuple[Array, Array]:
        """Value (samples, p) and derivative (samples, p, k) in all k parameters; theta as for `value`."""
        return self.tangent_in(signals, theta, tuple(range(self.count)), samples)

    def tangent_in(
        self,
        signals: Signals,
        theta: Array,
        which: tuple[int, ...],
        samples: int,
        *,
        valued: bool = True,
        block: int = 1,
    ) -> tuple[Array, Array]:
        """Value (samples, p), zero unless `valued`, and derivative (samples, p, len(which)) in those parameters.

        Or (samples // block, ...), means over blocks of samples.
        """
        theta = np.asarray(theta, dtype=float)
        if theta.shape not in ((self.count,), (samples, self.count)):
            raise ValueError(f"{self.count} parameters were expected, not an array {theta.shape}")
        varying = theta.ndim == 2
        sets = np.ascontiguousarray(theta.T) if varying else theta[None]
        value = np.zeros((samples // block, self.rows), order="F")
        derivative = np.zeros((samples // block, self.rows, 1, len(which)), order="F")
        outputs = [value[:, row, None] for row in range(self.rows)] if valued else []
        self._run(signals, sets, which, samples, outputs, derivative, varying=varying, block=block)
        return value, derivative[:, :, 0]

    def jacobians(self, signals: Signals, theta: Array, which: tuple[int, ...], samples: int) -> Array:
        """Derivative (samples, p, g, len(which)) in the parameters `which`, at each of g sets theta (g, k)."""
        theta = np.asarray(theta, dtype=float)
        if theta.ndim != 2 or theta.shape[1] != self.count:
            raise ValueError(f"sets of {self.count} parameters were expected, not an array {theta.shape}")
        derivative = np.zeros((samples, self.rows, len(theta), len(which)), order="F")
        self._run(signals, theta, which, samples, [], derivative, varying=False)
        return derivative

    def _run(
        self,
        signals: Signals,
        theta: Array,
        which: tuple[int, ...],
        samples: int,
        value: list[Array],
        derivative: Array,
        *,
        varying: bool,
        block: int = 1,
    ) -> None:
        """Write the value to the arrays (samples, g) of `value`, if any, and the derivative (samples, p, g, which)."""
        active = [(column, i) for column, i in enumerate(which) if i in self.active]
        outputs = [*value, *(derivative[:, row, :, column] for column, _ in active for row in range(self.rows))]
        evaluation = _evaluation(self, tuple(i for _, i in active), bool(value), varying)
        evaluation.run(self.columns(signals, samples), theta, outputs, block)

    def depending_on(self, signals: frozenset[str]) -> tuple[int, ...]:
        """The active parameters in which the derivative depends on one of these signals."""
        return _depending(self, signals)

    def derivative(self, which: tuple[int, ...]) -> Tape:
        """The tape of the derivative in some of the active parameters, column by column."""
        starts = [(self.active.index(i) + 1) * self.rows for i in which]
        return self.compiled.tape.only([start + row for start in starts for row in range(self.rows)])


@lru_cache(maxsize=512)
def _depending(function: VectorFunction, signals: frozenset[str]) -> tuple[int, ...]:
    compiled = function.compiled
    dependent = compiled.tape.depending_on([i for i, name in enumerate(function.inputs) if name in signals])
    results = compiled.tape.results
    rows = compiled.rows
    columns = {i: results[(j + 1) * rows : (j + 2) * rows] for j, i in enumerate(compiled.active)}
    return tuple(i for i, numbers in columns.items() if any(number in dependent for number in numbers))


@lru_cache(maxsize=512)
def _evaluation(function: VectorFunction, which: tuple[int, ...], valued: bool, varying: bool) -> TapeEvaluation:
    """Evaluation of the value, if `valued`, then of the derivative in active parameters, column by column."""
    compiled = function.compiled
    rows, columns = compiled.rows, [compiled.active.index(i) + 1 for i in which]
    wanted = [block * rows + row for block in ([0] * valued + columns) for row in range(rows)]
    return TapeEvaluation(compiled.tape.only(wanted), varying)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative (p, a) of a vector function in a parameters, at their nominal values.

    Operations on the signals alone are evaluated once for all values of the other parameters.
    """

    function: VectorFunction
    tape: Tape
    which: tuple[int, ...]

    @classmethod
    def of(cls, function: VectorFunction, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
        """Of a vector function in the parameters `which`, at these nominal values."""
        return _derived(function, which, nominal)

    @cached_property
    def _used(self) -> set[int]:
        return {number for _, *operands in self.tape.operations for number in operands} | set(self.tape.results)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it depends on."""
        return tuple(name for number, name in enumerate(self.function.inputs) if number in self._used)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it depends on."""
        first = self.tape.inputs
        return tuple(name for number, name in enumerate(self.function.names, first) if number in self._used)

    @cached_property
    def expression(self) -> Hashable:
        """A key, equal for sensitivities that are the same function of the same signals and parameters."""
        names: dict[int, object] = dict(enumerate((*self.function.inputs, *self.function.names, *self.tape.constants)))
        names[NO_OPERAND] = None

        def named(number: int) -> object:
            return names.get(number, number - self.tape.first)

        steps = tuple((name, named(a), named(b)) for name, a, b in self.tape.operations)
        return steps, tuple(map(named, self.tape.results))

    def values(self, signals: Signals, parameters: Mapping[str, Array], samples: int, block: int = 1) -> Array:
        """(samples // block, p, g, a), means over blocks of samples, at g values of each parameter (g,)."""
        count = max((len(parameters[name]) for name in self.parameters), default=1)
        theta = np.zeros((count, self.function.count))
        for name in self.parameters:
            theta[:, self.function.names.index(name)] = parameters[name]
        p, active = self.function.rows, self.function.active
        sensitivities = np.zeros((samples // block, p, count, len(self.which)), order="F")
        active_columns = [column for column, i in enumerate(self.which) if i in active]
        outputs = [sensitivities[:, row, :, column] for column in active_columns for row in range(p)]
        self._evaluation.run(self.function.columns(signals, samples), theta, outputs, block)
        return sensitivities

    @cached_property
    def _evaluation(self) -> TapeEvaluation:
        return TapeEvaluation(self.tape)


@lru_cache(maxsize=256)
def _derived(function: VectorFunction, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
    tape = function.derivative(tuple(i for i in which if i in function.active))
    return Sensitivity(function, partially_evaluated(tape, dict(zip(which, nominal, strict=True))), which)
