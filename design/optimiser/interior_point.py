"""Primal-dual interior-point method for an objective within limits."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from design.optimiser.limit_constraints import LimitRows
from design.optimiser.objective import Expansion, ObjectiveDerivatives

Array = NDArray[np.float64]


class TerminationStatus(Enum):
    """Termination status of an optimisation; the value describes it and its remedy."""

    CONVERGED = "converged: the conditions of a local optimum hold"
    CONTRACTED = "ended outside its limits and was contracted into them: try other starts, or more harmonics"
    ITERATIONS = "stopped at the most iterations allowed: allow more, or start nearer"
    INFEASIBLE = "found no trajectory within the limits: widen them, or give a series with more coefficients"
    FAILED = "the interior-point method failed: try other starts"
    INTERRUPTED = "interrupted: the best so far, which a whole search may exceed"


@dataclass(frozen=True, eq=False)
class OptimiserSolution:
    """Coefficients (k,), termination status and number of evaluations of the criterion."""

    coefficients: Array
    outcome: TerminationStatus
    evaluations: int


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


REMEMBERED_STEPS = 6
"""Steps of a limited-memory curvature: 6, 20 and 80 took as many iterations to the same optima (seven joints)."""
LEAST_CURVATURE = 1e-8
"""Of the product of a step and the gradient's change: a step with less along it says nothing of a convex curvature."""
STALLED_STEPS = 10
"""Steps without exact second derivatives over which a barrier problem has to gain, or it counts as solved."""
STALLED_GAIN = 0.01
"""Nats that it has to gain: by ten times as many steps a hundredth of a nat more is found."""


@dataclass(frozen=True, eq=False)
class PrimalDualPoint:
    """Coefficients (k,), the objective about them, slacks (2, R) and Lagrange multipliers (2, R)."""

    z: Array
    objective: Expansion
    slack: Array
    dual: Array

    def barrier(self, mu: float) -> float:
        """The objective of the barrier problem, to be minimised."""
        return -self.objective.value - mu * float(np.log(self.slack).sum())


@dataclass(frozen=True, eq=False)
class LimitedMemory:
    """A positive definite curvature (k, k) from the last steps and the changes of gradient along them (BFGS).

    Before the steps it is a multiple of one that has the last step's curvature (Nocedal and Wright 2006, section 7.2):
    directions in which nothing was seen move as far as the last one did.
    """

    pairs: deque[tuple[Array, Array]] = field(default_factory=lambda: deque(maxlen=REMEMBERED_STEPS))

    def remember(self, step: Array, change: Array) -> None:
        """A step (k,) and the gradient's change (k,) along it, unless the curvature along it is not positive."""
        if step @ change > LEAST_CURVATURE * np.linalg.norm(step) * np.linalg.norm(change):
            self.pairs.append((step, change))

    def matrix(self, slope: Array) -> Array:
        """(k, k); before the first step the size of the gradient `slope` (k,): a step of length one."""
        size = len(slope)
        if not self.pairs:
            return float(np.linalg.norm(slope)) * np.eye(size)
        step, change = self.pairs[-1]
        matrix = float(step @ change) / float(step @ step) * np.eye(size)
        for step, change in self.pairs:
            pushed = matrix @ step
            matrix += np.outer(change, change) / (step @ change) - np.outer(pushed, pushed) / (step @ pushed)
        return matrix


@dataclass(frozen=True, eq=False)
class InteriorPoint:
    """maximise f(z) within limits -1 <= c(z) <= 1, from a strictly feasible z, by a primal-dual interior-point method.

    For slacks s = 1 -+ c, A the slope of c and multipliers y the optimality conditions of the barrier problem are
    -f'(z) + A'(y_high - y_low) = 0 and s y = mu. Newton's step, with y eliminated, solves

        (H + A' diag(y / s) A) dz = f'(z) - A'(mu / s_high - mu / s_low),

    k equations whatever the number of rows. H is -f''(z) where the objective has it, without the curvature of limits
    that are not linear, else what the last steps say of both. Where the matrix is not positive definite its
    eigenvalues are replaced by their absolute values, so that the step is a descent direction (Gill, Murray and Wright
    1981, section 4.4.2.1). Steps are halved until the barrier problem's value decreases enough; mu follows Waechter and
    Biegler (2006).
    """

    derivatives: ObjectiveDerivatives
    limits: LimitRows
    adjustable: NDArray[np.bool_] | bool = True
    """(k,): the coefficients that move; all."""

    def solve(self, start: Array, *, first: float, last: float, iterations: int) -> OptimiserSolution:
        """From z (k,) inside; the barrier parameters mu, in nats, go from the first to the last.

        The active constraints (some dozens) leave about mu each to be gained.
        """
        slack, mu, evaluations = self.limits.slack(start), first, 1
        point = PrimalDualPoint(start, self.derivatives.at(start), slack, mu / slack)
        polytope, memory = self.limits.about(start, slack), LimitedMemory()
        barriers = list[float]()
        for _ in range(iterations):
            gradient, hessian = point.objective.gradient, point.objective.hessian
            stationarity = np.where(self.adjustable, polytope.pushed(point.dual) - gradient, 0.0)
            barriers.append(point.barrier(mu))
            stalled = hessian is None and _stalled(barriers)
            barrier = mu
            mu = _lower(mu, last) if stalled else _next_barrier(mu, last, point, stationarity)
            solved = (stalled and barrier <= last) or _error(point, stationarity, mu) <= BARRIER_TOLERANCE * mu
            if mu <= last and solved:
                return OptimiserSolution(point.z, TerminationStatus.CONVERGED, evaluations)
            barriers = barriers if mu == barrier else []
            slope = np.where(self.adjustable, polytope.pushed(mu / point.slack) - gradient, 0.0)
            curvature = memory.matrix(slope) if hessian is None else -hessian
            step = self._step(polytope.gram(point.dual / point.slack) + curvature, slope)
            moved, tried = self._line_search(point, polytope.change(step), step, float(slope @ step), mu)
            evaluations += tried
            if moved is None:
                return OptimiserSolution(point.z, TerminationStatus.FAILED, evaluations)
            before, polytope = polytope, self.limits.about(moved.z, moved.slack)
            if hessian is None:
                bent = polytope.pushed(moved.dual) - before.pushed(moved.dual)
                memory.remember(moved.z - point.z, bent - moved.objective.gradient + gradient)
            point = moved
        return OptimiserSolution(point.z, TerminationStatus.ITERATIONS, evaluations)

    def _step(self, matrix: Array, slope: Array) -> Array:
        """Newton's descent step (k,) of the coefficients that move."""
        if np.all(self.adjustable):
            return newton_descent_step(matrix, slope)
        step, moving = np.zeros(len(slope)), np.flatnonzero(self.adjustable)
        step[moving] = newton_descent_step(matrix[np.ix_(moving, moving)], slope[moving])
        return step

    def _line_search(
        self, point: PrimalDualPoint, change: Array, step: Array, slope: float, mu: float
    ) -> tuple[PrimalDualPoint | None, int]:
        """The point after the longest of t, t/2, t/4 .. of the step with Armijo decrease, and how many were tried."""
        change = np.stack([-change, change])
        dual_step = mu / point.slack - point.dual * (1 + change / point.slack)
        before, length, tried = point.barrier(mu), _longest(point.slack, change), 0
        while length > SHORTEST_STEP:
            z = point.z + length * step
            slack = point.slack + length * change if not self.limits.bent else self.limits.slack(z)
            if slack.min() > 0:
                tried += 1
                dual = point.dual + _longest(point.dual, dual_step) * dual_step
                dual = np.clip(dual, mu / (MULTIPLIER_SPREAD * slack), MULTIPLIER_SPREAD * mu / slack)
                moved = PrimalDualPoint(z, self.derivatives.at(z), slack, dual)
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
        mu = _lower(mu, last)
    return mu


def _lower(mu: float, last: float) -> float:
    return max(last, min(BARRIER_FACTOR * mu, float(mu**BARRIER_POWER)))


def _stalled(barriers: Sequence[float]) -> bool:
    """Whether the last steps of one barrier problem, by its values to be minimised, gained too little."""
    return len(barriers) > STALLED_STEPS and barriers[-1 - STALLED_STEPS] - barriers[-1] < STALLED_GAIN


def _error(point: PrimalDualPoint, stationarity: Array, mu: float) -> float:
    """The largest violation of stationarity and of complementarity s y = mu."""
    return max(float(np.abs(stationarity).max()), float(np.abs(point.slack * point.dual - mu).max()))


def _longest(values: Array, change: Array) -> float:
    """The largest share of a step, up to the whole, that keeps positive values positive."""
    return min(1.0, FRACTION_TO_BOUNDARY / max(float((-change / values).max()), np.finfo(float).tiny))
