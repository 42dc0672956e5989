"""Primal-dual interior-point method for an exact objective in a polytope."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from design.optimiser.limit_constraints import LimitConstraints, Polytope
from design.optimiser.objective import Objective, ObjectiveDerivatives

Array = NDArray[np.float64]

OPTIMALITY_TOLERANCE = 1e-6
"""Of the optimality conditions, in nats: negligible in numbers of measurements."""
ACCEPTABLE_TOLERANCE = 1e-4
"""Tolerance that is accepted when there is no improvement for some iterations."""
_SOLVER_LOCK = threading.Lock()
"""IPOPT's linear solver (MUMPS) has process-wide state: threads take turns."""


class TerminationStatus(Enum):
    """Termination status of an optimisation; the value describes it and its remedy."""

    CONVERGED = "converged: the conditions of a local optimum hold"
    CONTRACTED = "ended outside its limits and was contracted into them: try other starts, or more harmonics"
    ITERATIONS = "stopped at the most iterations allowed: allow more, or start nearer"
    INFEASIBLE = "found no trajectory within the limits: widen them, or give a series with more coefficients"
    FAILED = "the interior-point method failed: try other starts"
    INTERRUPTED = "interrupted: the best so far, which a whole search may exceed"


_STATUS = {
    "Solve_Succeeded": TerminationStatus.CONVERGED,
    "Solved_To_Acceptable_Level": TerminationStatus.CONVERGED,
    "Maximum_Iterations_Exceeded": TerminationStatus.ITERATIONS,
    "Infeasible_Problem_Detected": TerminationStatus.INFEASIBLE,
    "Restoration_Failed": TerminationStatus.INFEASIBLE,
}


@dataclass(frozen=True, eq=False)
class OptimiserSolution:
    """Coefficients (k,), termination status and number of evaluations of the criterion."""

    coefficients: Array
    outcome: TerminationStatus
    evaluations: int


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """minimise f(x) within low <= g(x) <= high, from x = start.

    `hessian` is the upper triangle of f's second derivative times `factor` and of g's in the multipliers, or None.
    """

    x: Any
    f: Any
    g: Any
    low: Array
    high: Array
    start: Array
    hessian: Any = None

    def solve(self, *, iterations: int, warm: bool) -> OptimiserSolution:
        """By IPOPT; `warm`: the start is nearly the solution, and the barrier parameter starts small."""
        program = {"x": self.x, "f": self.f, "g": self.g}
        solver = ca.nlpsol("design", "ipopt", program, self._options(iterations, warm))
        with _SOLVER_LOCK:
            solution = solver(x0=self.start, lbg=self.low, ubg=self.high)
        stats: Mapping[str, Any] = solver.stats()
        return OptimiserSolution(
            coefficients=np.array(solution["x"]).ravel(),
            outcome=_STATUS.get(stats["return_status"], TerminationStatus.FAILED),
            evaluations=int(stats["n_call_nlp_f"]),
        )

    def _options(self, iterations: int, warm: bool) -> dict[str, Any]:
        options: dict[str, Any] = {"print_time": False, "show_eval_warnings": False, "ipopt.print_level": 0}
        options |= {"ipopt.sb": "yes", "ipopt.tol": OPTIMALITY_TOLERANCE, "ipopt.acceptable_tol": ACCEPTABLE_TOLERANCE}
        options |= {"ipopt.max_iter": iterations}
        if warm:
            options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
        if self.hessian is None:
            return options | {"ipopt.hessian_approximation": "limited-memory"}
        return options | {"hess_lag": self.hessian}


def limit_constrained_program(objective: Objective, rows: LimitConstraints, start: Array) -> NonlinearProgram:
    """Maximise the objective within the constraints, from coefficients (k,) that need not be feasible."""
    z = ca.MX.sym("z", objective.series.size)
    limits, low, high = rows.graph(z)
    hessian = None
    if objective.exact:
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", limits.numel())
        whole = ca.triu(rows.curvature(z, multipliers) - factor * objective.hessian(z))
        hessian = ca.Function("nlp_hess_l", [z, ca.MX.sym("none", 0), factor, multipliers], [whole])
    return NonlinearProgram(z, -objective.graph(z), limits, low, high, start, hessian)


BARRIER_FACTOR = 0.2
"""The barrier parameter goes from mu to this multiple of it, or to a power of it (Waechter and Biegler 2006, eq. 7)."""
BARRIER_POWER = 1.5
"""That power, taken where it is smaller: convergence near the solution is superlinear."""
BARRIER_TOLERANCE = 10.0
"""A barrier problem is solved when its error is below this multiple of mu (the same, eq. 6)."""
FRACTION_TO_BOUNDARY = 0.99
"""Fraction to the boundary: share of the way to the nearest constraint that a step may go (the same, eq. 8)."""
ARMIJO_SHARE = 1e-4
"""Armijo's share of the predicted decrease: any small one will do."""
SHORTEST_STEP = 1e-10
"""A step as short as this no longer changes the point."""
BARRIER_ROUNDING = 1e-12
"""Of a barrier problem's value, which is a sum of thousands of logarithms: less than this is no change."""
MULTIPLIER_SPREAD = 1e10
"""Factor by which a multiplier may differ from mu over its slack, either way (the same, eq. 16)."""
CURVATURE_FLOOR = 1e-8
"""Of the largest curvature: along directions with less the step is no longer than with this."""


@dataclass(frozen=True, eq=False)
class PrimalDualPoint:
    """Coefficients (k,), the criterion there, slacks (2, R) and Lagrange multipliers (2, R)."""

    z: Array
    value: float
    slack: Array
    dual: Array

    def barrier(self, mu: float) -> float:
        """The objective of the barrier problem, to be minimised."""
        return -self.value - mu * float(np.log(self.slack).sum())


@dataclass(frozen=True, eq=False)
class InteriorPoint:
    """maximise f(z) within a polytope, from a strictly feasible z, by a primal-dual interior-point method.

    For slacks s = 1 -+ (A z - middle) and multipliers y the optimality conditions of the barrier problem are
    -f'(z) + A'(y_high - y_low) = 0 and s y = mu. Newton's step, with y eliminated, solves

        (-f''(z) + A' diag(y / s) A) dz = f'(z) - A'(mu / s_high - mu / s_low),

    k equations whatever the number of rows. Where the matrix is not positive definite its eigenvalues are replaced by
    their absolute values, so that the step is a descent direction (Gill, Murray and Wright 1981, section 4.4.2.1).
    Steps are halved until the barrier problem's value decreases enough; mu follows Waechter and Biegler (2006).
    """

    derivatives: ObjectiveDerivatives
    polytope: Polytope

    def solve(self, start: Array, *, first: float, last: float, iterations: int) -> OptimiserSolution:
        """From z (k,) inside; the barrier parameters mu, in nats, go from the first to the last.

        The active constraints (some dozens) leave about mu each to be gained.
        """
        slack, mu, evaluations = self.polytope.slack(start), first, 1
        point = PrimalDualPoint(start, self.derivatives.value(start), slack, mu / slack)
        for _ in range(iterations):
            gradient, hessian = self.derivatives.second_order(point.z)
            stationarity = self.polytope.pushed(point.dual) - gradient
            mu = _next_barrier(mu, last, point, stationarity)
            if mu <= last and _error(point, stationarity, mu) <= BARRIER_TOLERANCE * mu:
                return OptimiserSolution(point.z, TerminationStatus.CONVERGED, evaluations)
            slope = self.polytope.pushed(mu / point.slack) - gradient
            step = newton_descent_step(self.polytope.gram(point.dual / point.slack) - hessian, slope)
            moved, tried = self._line_search(point, step, float(slope @ step), mu)
            evaluations += tried
            if moved is None:
                return OptimiserSolution(point.z, TerminationStatus.FAILED, evaluations)
            point = moved
        return OptimiserSolution(point.z, TerminationStatus.ITERATIONS, evaluations)

    def _line_search(
        self, point: PrimalDualPoint, step: Array, slope: float, mu: float
    ) -> tuple[PrimalDualPoint | None, int]:
        """The point after the longest of t, t/2, t/4 .. of the step with Armijo decrease, and how many were tried."""
        change = self.polytope.change(step)
        change = np.stack([-change, change])
        dual_step = mu / point.slack - point.dual * (1 + change / point.slack)
        before, length, tried = point.barrier(mu), _longest(point.slack, change), 0
        while length > SHORTEST_STEP:
            z, slack, tried = point.z + length * step, point.slack + length * change, tried + 1
            dual = point.dual + _longest(point.dual, dual_step) * dual_step
            dual = np.clip(dual, mu / (MULTIPLIER_SPREAD * slack), MULTIPLIER_SPREAD * mu / slack)
            moved = PrimalDualPoint(z, self.derivatives.value(z), slack, dual)
            if moved.barrier(mu) <= before + ARMIJO_SHARE * length * slope + BARRIER_ROUNDING * abs(before):
                return moved, tried
            length /= 2
        return None, tried


def newton_descent_step(matrix: Array, slope: Array) -> Array:
    """-matrix^-1 slope (k,), or with the matrix's eigenvalues made positive, in the scale of its diagonal."""
    try:
        return np.asarray(-cho_solve(cho_factor(matrix, check_finite=False), slope, check_finite=False))
    except LinAlgError:
        scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
        values, axes = np.linalg.eigh(matrix * scale * scale[:, None])
        size = np.abs(values)
        return np.asarray(
            -scale * (axes @ ((axes.T @ (scale * slope)) / np.maximum(size, CURVATURE_FLOOR * size.max())))
        )


def _next_barrier(mu: float, last: float, point: PrimalDualPoint, stationarity: Array) -> float:
    """The barrier parameter, decreased as long as its problem is solved."""
    while mu > last and _error(point, stationarity, mu) <= BARRIER_TOLERANCE * mu:
        mu = max(last, min(BARRIER_FACTOR * mu, mu**BARRIER_POWER))
    return mu


def _error(point: PrimalDualPoint, stationarity: Array, mu: float) -> float:
    """The largest violation of stationarity and of complementarity s y = mu."""
    return max(float(np.abs(stationarity).max()), float(np.abs(point.slack * point.dual - mu).max()))


def _longest(values: Array, change: Array) -> float:
    """The largest share of a step, up to the whole, that keeps positive values positive."""
    return min(1.0, FRACTION_TO_BOUNDARY / max(float((-change / values).max()), np.finfo(float).tiny))
