"""Dual variables (D, c), and the dual function F that must not exceed k in any viable state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.bound.periodicity_conditions import PeriodicityConditions
from design.bound.viable_states import ViableStates
from design.information import Experiment
from modeling.errors import InputError
from modeling.evaluation.tape import Tape
from modeling.evaluation.tape_evaluation import TapeEvaluation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DualVariables:
    """The dual variables: D (k, k) positive definite, and c (K,) of the periodicity conditions."""

    D: Array
    c: Array

    @property
    def root(self) -> Array:
        """R (k, k) with D = R R'."""
        return np.asarray(np.linalg.cholesky(self.D))

    @property
    def stacked(self) -> Array:
        """The elements of R, column by column, then c."""
        return np.concatenate([self.root.ravel(order="F"), self.c])

    @property
    def value(self) -> float:
        """-ln det D."""
        return -float(np.linalg.slogdet(self.D)[1])

    def scaled(self, factor: float) -> DualVariables:
        """The dual variables whose F is `factor` times as large."""
        return DualVariables(self.D * factor, self.c * factor)


@dataclass(frozen=True, eq=False)
class DualFunction:
    """F(x) = tr(D Phi(x)'Phi(x)) + sum_i c_i (L h_i)(x) of states x = (q, dq, ddq), as compiled functions.

    Phi, the columns of the experiment, has to be affine in ddq. Then F is convex in ddq, since D is positive definite
    and L h is affine in it, and its largest value over a box of ddq is at one of the 2^n vertices.

    Raises InputError when the columns are not affine in ddq, or do not follow from the state alone.
    """

    experiment: Experiment
    conditions: PeriodicityConditions

    def __post_init__(self) -> None:
        import casadi as ca

        state = ca.SX.sym("x", 3 * self.joints)
        if any(ca.which_depends(self._sample(state), state[2 * self.joints :], 2, False)):
            raise InputError(
                what="the columns of an effect are not affine in the accelerations",
                where="bound",
                remedy="take the bound of the model without that effect",
            )

    def __getstate__(self) -> dict[str, Any]:
        # CasADi's functions can be pickled for the workers of a pool, its symbols cannot.
        return {name: value for name, value in vars(self).items() if name != "_symbols"}

    @property
    def viable(self) -> ViableStates:
        """The viable states."""
        return self.conditions.viable

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return self.viable.joints

    @property
    def size(self) -> int:
        """The number of parameters k."""
        return self.experiment.size

    # ------------------------------------------------------------------------------------- numerically

    def moments(self, states: Array) -> tuple[Array, Array]:
        """Phi'Phi (N, k, k) and L h (N, K) in states (N, 3n)."""
        found = self._moments.values(list(states.T))
        gram, rates = found[: self.size**2], found[self.size**2 :]
        return gram.T.reshape(-1, self.size, self.size), rates.T

    def values(self, points: Array, dual: DualVariables) -> Array:
        """F (N, 2^n) at points (N, 2n) of the cube and every vertex of ddq."""
        return self._vertex_evaluation.values(list(points.T), dual.stacked).T

    def value_and_gradient(self, points: Array, ddq: Array, dual: DualVariables) -> tuple[Array, Array]:
        """F (N,) and its derivative (N, 2n) by the points (N, 2n) of the cube, ddq (N, n) given."""
        value, *gradient = self._gradient_evaluation.values([*points.T, *ddq.T], dual.stacked)
        return value, np.stack(gradient, axis=1)

    def states(self, points: Array, ddq: Array) -> Array:
        """The states (N, 3n) of points of the cube with ddq (N, n)."""
        return np.hstack([*self.viable.phase(points), ddq])

    # ---------------------------------------------------------------------------------- compiled functions

    @cached_property
    def _vertex_evaluation(self) -> TapeEvaluation:
        """F at all vertices (2^n,) of ddq, in a point and (R, c)."""
        import casadi as ca

        point, _, root, c = self._symbols
        parts = self._parts(*self.viable.phase(point), c)
        values = [_value(parts, vertex, root) for vertex in self.viable.vertices]
        return TapeEvaluation(Tape.of(point, ca.veccat(root, c), ca.vertcat(*values)))

    @cached_property
    def gradient(self) -> Any:
        """CasADi function of (point, ddq, R, c): F, and its gradient by the point (2n,)."""
        import casadi as ca

        point, ddq, root, c = self._symbols
        value = _value(self._parts(*self.viable.phase(point), c), ddq, root)
        return _function([point, ddq, root, c], [value, ca.gradient(value, point)])

    @cached_property
    def _gradient_evaluation(self) -> TapeEvaluation:
        """F and its gradient, in (point, ddq) and (R, c)."""
        import casadi as ca

        point, ddq, root, c = self._symbols
        return TapeEvaluation(
            Tape.of(ca.vertcat(point, ddq), ca.veccat(root, c), ca.vertcat(*self.gradient(point, ddq, root, c)))
        )

    @cached_property
    def _symbols(self) -> tuple[Any, Any, Any, Any]:
        import casadi as ca

        n, k = self.joints, self.size
        sizes = {"u": (2 * n, 1), "a": (n, 1), "R": (k, k), "c": (len(self.conditions), 1)}
        point, ddq, root, c = (ca.SX.sym(name, *shape) for name, shape in sizes.items())
        return point, ddq, root, c

    @cached_property
    def _sample(self) -> Any:
        return self.experiment.sample()

    def _columns(self, q: Any, dq: Any, ddq: Any) -> Any:
        import casadi as ca

        return ca.reshape(self._sample(ca.vertcat(q, dq, ddq)), -1, self.size)

    @cached_property
    def _parts(self) -> Any:
        """CasADi function of (q, dq, c): Phi at ddq = 0, its derivative by ddq, and of H = c'h: H_q dq and H_dq."""
        import casadi as ca

        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        c = ca.SX.sym("c", len(self.conditions))
        columns, H = self._columns(q, dq, ddq), ca.dot(c, self.conditions.graph(q, dq))
        constant = ca.substitute(columns, ddq, ca.SX.zeros(self.joints))
        return _function(
            [q, dq, c], [constant, ca.jacobian(columns, ddq), ca.dot(ca.gradient(H, q), dq), ca.gradient(H, dq)]
        )

    @cached_property
    def _moments(self) -> TapeEvaluation:
        """Phi'Phi column by column, then L h, in a state."""
        import casadi as ca

        q, dq, ddq = (ca.SX.sym(name, self.joints) for name in ("q", "dq", "ddq"))
        columns = self._columns(q, dq, ddq)
        rates = ca.jtimes(self.conditions.graph(q, dq), ca.vertcat(q, dq), ca.vertcat(dq, ddq))
        results = ca.vertcat(ca.vec(columns.T @ columns), rates)
        return TapeEvaluation(Tape.of(ca.vertcat(q, dq, ddq), ca.SX(0, 1), results))


def _value(parts: Any, ddq: Any, root: Any) -> Any:
    """F from the parts of it that do not depend on ddq: |(Phi_0 + sum_j Phi_j ddq_j) R|² + H_q dq + H_dq ddq."""
    import casadi as ca

    constant, slope, velocity_term, acceleration_slope = parts
    columns = constant + ca.reshape(slope @ ddq, *constant.shape)
    return ca.sumsqr(columns @ root) + velocity_term + ca.dot(acceleration_slope, ddq)


def _function(arguments: list[Any], results: list[Any]) -> Any:
    import casadi as ca

    return ca.Function("dual", arguments, [ca.cse(ca.densify(r)) for r in results])
