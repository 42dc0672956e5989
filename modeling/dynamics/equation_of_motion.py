"""Compiled equation of motion of the deflection, its residual and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling.compiled.tape import NO_OPERAND, Operations, Tape
from modeling.compiled.tape_evaluation import TapeEvaluation

if TYPE_CHECKING:
    from modeling.compiled.vector_function import VectorFunction


Array = NDArray[np.float64]


DEFLECTION_TOLERANCE = 1e-11
"""Convergence tolerance of the deflection: last correction relative to its size, close to rounding."""


@dataclass(frozen=True, eq=False)
class SplitEquation:
    """F (d,) of signals (m,) and theta (k,) in two tapes, split by dependence on the deflection (3 d,).

    before   of signals and theta, independent of the deflection; its first `changing` results are series, the others
             constant over the samples
    after    F of the deflection and of the series, with the constants as its parameters
    """

    before: TapeEvaluation
    after: TapeEvaluation
    changing: int
    components: int

    @classmethod
    def of(cls, tape: Tape, components: int) -> Self:
        """Split of a tape of signals (m,) and parameters (theta, deflection (components,))."""
        m, theta = tape.inputs, tape.parameters - components
        deflection = range(m + theta, m + theta + components)
        moved = tape.depending_on(deflection)
        dependent = [number for number in range(tape.first, tape.size) if number in moved]
        operations = [tape.operations[number - tape.first] for number in dependent]
        operands_used = {operand for _, *operands in operations for operand in operands} | {*tape.results}
        given = sorted(operands_used - moved - {NO_OPERAND})
        varying = tape.depending_on(range(m))
        constants = range(m + theta + components, tape.first)
        series = [number for number in given if number in varying]
        fixed = [number for number in given if number not in varying and number not in constants]
        order = [*deflection, *series, *fixed, *constants, *dependent]
        places = {number: place for place, number in enumerate(order)} | {NO_OPERAND: NO_OPERAND}
        after = Tape(
            inputs=components + len(series),
            parameters=len(fixed),
            constants=tape.constants,
            operations=Operations.of((name, places[a], places[b]) for name, a, b in operations),
            results=tuple(places[number] for number in tape.results),
        )
        everything = Tape(m, tape.parameters, tape.constants, tape.operations, (*series, *fixed))
        before = everything.only(range(len(series) + len(fixed)))
        return cls(TapeEvaluation(before), TapeEvaluation(after), len(series), components)

    def at(self, signals: Array, theta: Array) -> MotionResidual:
        """At the signals (m, n) of n samples and at theta (k,)."""
        series = np.zeros((self.changing, signals.shape[1]))
        fixed = np.zeros(len(self.before.tape.results) - self.changing)
        outputs = [*series[:, :, None], *fixed[:, None, None]]
        undeflected = np.concatenate([np.asarray(theta, dtype=float), np.zeros(self.components)])
        self.before.run(list(signals), undeflected[None], outputs)
        return MotionResidual(self.after, series, fixed)


@dataclass(frozen=True, eq=False)
class MotionResidual:
    """F as a function of the deflection: `SplitEquation.after` with its series (c, n) and constants (f,)."""

    evaluation: TapeEvaluation
    series: Array
    fixed: Array

    def of(self, deflection: Array) -> Array:
        """F (d, n) at a deflection (3 d, n)."""
        value = np.zeros((len(self.evaluation.tape.results), deflection.shape[1]))
        self.evaluation.run([*deflection, *self.series], self.fixed[None], list(value[:, :, None]))
        return value


NON_ANALYTIC = frozenset({"fabs", "sign", "atan2"})
"""Operations without an analytic continuation to complex arguments."""

COMPLEX_STEP = 1e-30
"""Imaginary step: its square underflows relative to 1, its product with a derivative does not."""


@dataclass(frozen=True, eq=False)
class EquationOfMotion:
    """F (d,) of signals (m,), parameters theta (k,), and angles, rates and accelerations of the deflection (3 d,).

    column  F with theta and the deflection, in this order, as its parameters; `parameters` is k
    """

    column: VectorFunction
    parameters: int

    @property
    def size(self) -> int:
        """The number d of angles."""
        return self.column.rows

    def at(self, signals: Array, deflection: Array, theta: Array) -> tuple[Array, Array]:
        """F (n, d) and its derivative in the deflection (n, d, 3 d), at samples (n, ...) and theta (k,)."""
        value, slopes = _series(len(deflection), self.size), _series(len(deflection), self.size, deflection.shape[1])
        outputs = [value[:, row, None] for row in range(self.size)]
        outputs += [
            slopes[:, row, i - self.parameters, None] for i in self._deflection_components for row in range(self.size)
        ]
        self._run(self._value_and_derivative, signals, deflection, theta, outputs)
        return value, slopes

    def over(self, signals: Array, theta: Array) -> MotionResidual:
        """F at signals (n, m) and theta (k,), as a function of the deflection."""
        return self._split.at(np.ascontiguousarray(signals.T), theta)

    def by_parameters(self, signals: Array, deflection: Array, theta: Array) -> Array:
        """The derivative of F in theta, (n, d, k)."""
        slopes = _series(len(deflection), self.size, self.parameters)
        outputs = [slopes[:, row, i, None] for i in self._parameters for row in range(self.size)]
        self._run(self._derivative_in_theta, signals, deflection, theta, outputs)
        return slopes

    def mean_change(self, signals: Array, theta: Array) -> Array:
        """The derivative in theta of the mean over samples of dF/db at zero deflection b, (d, 3 d, k).

        Complex step, without cancellation: dF/db(theta + i h) = dF/db + i h d²F/db dtheta + O(h²) (Squire and Trapp,
        SIAM Review 40, 1998).
        """
        if NON_ANALYTIC & {name for name, _, _ in self._complex_derivative.tape.operations}:
            return self._mean_change_by_graph(signals, theta)
        n, sets = len(signals), np.tile(theta.astype(complex), (len(self._parameters), 1))
        sets[range(len(self._parameters)), self._parameters] += COMPLEX_STEP * 1j
        changes = np.zeros((len(self._deflection_components), self.size, n, len(sets)), dtype=complex)
        changing = [*np.ascontiguousarray(signals.T, dtype=complex), *np.zeros((3 * self.size, n), dtype=complex)]
        self._complex_derivative.run(changing, sets, list(changes.reshape(-1, n, len(sets))))
        mean = np.zeros((self.size, 3 * self.size, self.parameters))
        places = np.ix_(range(self.size), [i - self.parameters for i in self._deflection_components], self._parameters)
        mean[places] = changes.imag.mean(axis=2).transpose(1, 0, 2) / COMPLEX_STEP
        return mean

    def _mean_change_by_graph(self, signals: Array, theta: Array) -> Array:
        n, undeflected = len(signals), np.zeros((3 * self.size, len(signals)))
        total = self._mixed.map(n, [False, False, True], [True])(signals.T, undeflected, theta).full()
        return np.asarray(total / n, dtype=np.float64).reshape((self.size, 3 * self.size, len(theta)), order="F")

    @staticmethod
    def _run(evaluation: TapeEvaluation, signals: Array, deflection: Array, theta: Array, outputs: list[Array]) -> None:
        changing = [*np.ascontiguousarray(signals.T), *np.ascontiguousarray(deflection.T)]
        evaluation.run(changing, np.asarray(theta, dtype=float)[None], outputs)

    @property
    def _deflection_components(self) -> list[int]:
        """Active parameters of `column` that belong to the deflection."""
        return [i for i in self.column.active if i >= self.parameters]

    @property
    def _parameters(self) -> list[int]:
        """Active parameters of `column` that belong to theta."""
        return [i for i in self.column.active if i < self.parameters]

    @cached_property
    def _value_and_derivative(self) -> TapeEvaluation:
        """F, then its derivative in the deflection, component by component."""
        return self._evaluation(self._deflection_components, valued=True)

    @cached_property
    def _complex_derivative(self) -> TapeEvaluation:
        """The derivative of F in the deflection, component by component, in complex arithmetic."""
        return TapeEvaluation(self._evaluation(self._deflection_components, valued=False).tape, dtype=complex)

    @cached_property
    def _derivative_in_theta(self) -> TapeEvaluation:
        """The derivative of F in theta, parameter by parameter."""
        return self._evaluation(self._parameters, valued=False)

    @cached_property
    def _split(self) -> SplitEquation:
        """F split by dependence on the deflection."""
        return SplitEquation.of(self.column.compiled.tape.only(range(self.size)), 3 * self.size)

    def _evaluation(self, which: Sequence[int], *, valued: bool) -> TapeEvaluation:
        compiled = self.column.compiled
        blocks = [0] * valued + [compiled.active.index(i) + 1 for i in which]
        tape = compiled.tape.only([block * self.size + row for block in blocks for row in range(self.size)])
        return TapeEvaluation(tape.with_inputs(range(self.parameters, self.column.count)))

    @cached_property
    def _mixed(self) -> Any:
        u, both = self.column.symbols
        theta, deflection = both[: self.parameters], both[self.parameters :]
        slopes = ca.vec(ca.jacobian(self.column.graph, deflection))
        mixed = ca.densify(ca.jacobian(slopes, theta))
        return ca.Function("mixed", [u, deflection, theta], [mixed])


def _series(samples: int, *shape: int) -> Array:
    """Zeros (samples, ...), contiguous over the samples of each entry."""
    return np.moveaxis(np.zeros((*shape, samples)), -1, 0)
