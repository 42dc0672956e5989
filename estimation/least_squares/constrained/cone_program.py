"""Least squares within bounds and the cone of consistent tools: by CVXPY and Clarabel, within bounds alone by SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.quadratic_model import QuadraticModel
from estimation.least_squares.constraints.conic_solver import cvxpy, solve_conic
from estimation.least_squares.constraints.feasible_region import FeasibleRegion

Array = NDArray[np.float64]

UNIDENTIFIABLE_DAMPING = 1e-6
"""Damping of the unidentifiable directions: too small to affect the identifiable ones."""
DISTANT_BOUND = 1e4
"""Distance in step lengths beyond which a bound is left out for conditioning; the next step has it."""
BVLS_STEPS = 200
"""Most steps of `lsq_linear`; it takes about one for each active bound."""


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """Parameters (k,), multipliers of lower and upper bounds, (k,), in chi-square per unit, and of J, Z (n, n)."""

    theta: Array
    low: Array
    high: Array
    Z: Array


@dataclass(frozen=True, eq=False)
class ConeProgram:
    """Minimise |R d - z|² + prior + damping |y|² over the region, d = B y, B of the quadratic model.

    In y the chi-square has unit curvature. The program is in u = y / length, the objective divided by length², each
    bound by its parameter's std and the length, and J scaled to unit size: in any units and at any distance of the
    region, the solver gets numbers about 1.
    """

    local: QuadraticModel
    region: FeasibleRegion
    damping: float

    @cached_property
    def length(self) -> float:
        """Scale of the step in std: 1 plus the distances to the unconstrained minimum and to the region."""
        local, region = self.local, self.region
        beyond = np.maximum(region.low - local.theta, local.theta - region.high) / local.spread
        values, vectors = np.linalg.eigh(region.matrix(local.theta) / np.outer(*[inertia_scale(local, region)] * 2))
        inner = vectors / inertia_scale(local, region)[:, None]
        sizes = np.linalg.norm(np.einsum("na,knm,ma->ak", inner, region.slopes, inner) @ local.basis, axis=1)
        below = -values / np.where(sizes > 0, sizes, 1.0)
        return 1 + float(np.linalg.norm(local.reach)) + float(max(beyond.max(initial=0.0), below.max(initial=0.0)))

    @property
    def _whole(self) -> float:
        """Divisor of the objective."""
        return self.length**2 + (0.0 if self.region.prior is None else self.region.prior.weight)

    @property
    def _held(self) -> Array:
        """(k,) root of the damping of each whitened parameter."""
        return np.sqrt(self.damping + np.where(self.local.identifiable, 0.0, UNIDENTIFIABLE_DAMPING))

    def _objective(self, u: Any) -> Any:
        cp, local = cvxpy(), self.local
        squares = cp.sum_squares((local.data.root @ local.basis) @ u - local.data.target / self.length)
        objective = self.length**2 / self._whole * (squares + cp.sum_squares(cp.multiply(self._held, u)))
        prior = self.region.prior
        if prior is None:
            return objective
        X = self._moved(u, prior.inertia.at(local.theta), prior.inertia.slopes, prior.whitening)
        return objective + prior.weight / self._whole * (cp.trace(X) - cp.log_det(X))

    def _moved(self, u: Any, matrix: Array, slopes: Array, outer: Array) -> Any:
        """outer J(theta + B y) outer', symmetric, as a CVXPY expression."""
        n = len(matrix)
        turned = (outer @ slopes @ outer.T).reshape(len(slopes), -1).T @ self.local.basis * self.length
        return outer @ matrix @ outer.T + cvxpy().reshape(turned @ u, (n, n), order="C")

    def solve(self) -> ConeSolution | None:
        """The solution, None when the solver fails."""
        bounds_alone = self.region.inertia is None and self.region.prior is None
        return self._by_bvls() if bounds_alone else self._by_clarabel()

    def _by_bvls(self) -> ConeSolution | None:
        """Within bounds alone, by bounded-variable least squares (Stark and Parker 1995) on the parameters in std."""
        from scipy.optimize import lsq_linear  # slow to import and rarely needed

        local, region, free = self.local, self.region, ~self.region.fixed
        held = self._held[:, None] * np.linalg.inv(local.basis)
        rows = np.concatenate([local.data.root, held]) * local.spread
        low, high = ((end - local.theta) / local.spread for end in (region.low, region.high))
        x = np.where(free, 0.0, low)
        target = np.concatenate([local.data.target, np.zeros(len(held))]) - rows @ x
        found = lsq_linear(
            rows[:, free], target, (low[free], high[free]), method="bvls", tol=1e-14, max_iter=BVLS_STEPS
        )
        if not found.success:
            return None
        x[free] = found.x
        theta = np.where(x <= low, region.low, np.where(x >= high, region.high, local.theta + local.spread * x))
        idle = np.zeros(len(theta))  # the active bounds are met exactly, and need no multiplier to be recognised
        return ConeSolution(theta, idle, idle, np.zeros((0, 0)))

    def _by_clarabel(self) -> ConeSolution | None:
        cp, local, region = cvxpy(), self.local, self.region
        u, unit = cp.Variable(len(local.theta)), local.spread * self.length
        slacks = np.array([local.theta - region.low, region.high - local.theta]) / unit
        side, index = np.nonzero(slacks < DISTANT_BOUND)
        inwards = np.where(side == 0, 1.0, -1.0) * self.length / unit[index]
        within = slacks[side, index] + (inwards[:, None] * local.basis[index]) @ u >= 0
        scale = inertia_scale(local, region, self.length)
        cone = self._moved(u, region.matrix(local.theta), region.slopes, np.diag(1 / scale)) >> 0
        conditions = [condition for condition, size in ((within, side.size), (cone, scale.size)) if size]
        if not solve_conic(cp.Problem(cp.Minimize(self._objective(u)), conditions)):
            return None
        theta = np.clip(local.theta + local.basis @ u.value * self.length, region.low, region.high)
        multipliers = np.zeros_like(slacks)
        if side.size:
            multipliers[side, index] = self._whole * within.dual_value / unit[index]
        Z = self._whole * cone.dual_value / np.outer(scale, scale) if scale.size else np.zeros((0, 0))
        return ConeSolution(theta, multipliers[0], multipliers[1], Z)


def inertia_scale(local: QuadraticModel, region: FeasibleRegion, length: float = 1.0) -> Array:
    """Square roots (n,) of the size of J's diagonal: its value, or its change by `length` std of the parameters."""
    diagonal = np.abs(np.diag(region.matrix(local.theta)))
    shifts = length * np.linalg.norm(np.diagonal(region.slopes, axis1=1, axis2=2).T @ local.basis, axis=1)
    return np.asarray(np.sqrt(np.maximum(np.maximum(diagonal, shifts), 1e-300)))
