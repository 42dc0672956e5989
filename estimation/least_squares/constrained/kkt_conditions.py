"""Karush-Kuhn-Tucker conditions at a point, with the multipliers that meet them best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.active_set import ActiveSet, smat
from estimation.least_squares.constrained.lagrange_multipliers import ROUNDING_SHARE, LagrangeMultipliers

Array = NDArray[np.float64]

KKT_TOLERANCE = 2e-3
"""Slope of the chi-square, per std, below which a point is a minimum: a step from there gains less than 1e-6."""

FEASIBILITY_TOLERANCE = 1e-9
"""Largest admissible infeasibility: eigenvalues of J have a rounding of a few 1e-16 of its largest."""


@dataclass(frozen=True, eq=False)
class KKTConditions:
    """Lagrange multipliers of the active set at a point, and the residual of the KKT conditions.

    The gradient of chi-square and prior has to be the sum of the normals of the active constraints, each times a
    nonnegative multiplier (Z of J positive semidefinite), and the point feasible; inactive constraints have no
    multiplier, so that complementarity holds by construction.
    """

    active_set: ActiveSet

    @cached_property
    def gradient(self) -> Array:
        """(k,) of chi-square and prior in the parameters."""
        rows, targets = sum_of_squares(self.active_set)
        return np.asarray(-2 * rows.T @ targets)

    @cached_property
    def _lagrange(self) -> LagrangeMultipliers:
        return LagrangeMultipliers.of(self.active_set, self.gradient)

    @property
    def unit_multipliers(self) -> Array:
        """(c,) multipliers in the order of the active set's normals, chi-square per std."""
        return self._lagrange.unit_multipliers

    @property
    def multipliers(self) -> Array:
        """(c,) multipliers in the order of the active set's normals, chi-square per unit."""
        return self.unit_multipliers / self._lagrange.sizes

    @property
    def inner(self) -> Array:
        """(rank, rank) multiplier of v' J v."""
        return smat(self.multipliers[len(self.active_set.ends) :], self.active_set.rank)

    @property
    def Z(self) -> Array:
        """(n, n) multiplier of J."""
        return np.asarray(self.active_set.null @ self.inner @ self.active_set.null.T)

    def of_ends(self, *, lower: bool) -> Array:
        """(k,) multipliers of the lower or of the upper bounds."""
        found = np.zeros(len(self.active_set.low))
        for (index, is_lower), value in zip(self.active_set.ends, self.multipliers, strict=False):
            found[index] += max(value if is_lower is lower else -value, 0.0)
        return found

    @property
    def slope(self) -> float:
        """Norm of the gradient of the Lagrangian, chi-square per std."""
        gradient = self.gradient - self.active_set.normals.T @ self.multipliers
        return float(np.linalg.norm(self.active_set.local.basis.T @ gradient))

    @property
    def wrong_sign(self) -> float:
        """Dual infeasibility: size of the most negative multiplier of an inequality, chi-square per std."""
        return self._lagrange.wrong_sign(self.unit_multipliers)

    @property
    def outside(self) -> float:
        """Primal infeasibility: of a bound in std, of J relative to its size."""
        active_set, region, theta = self.active_set, self.active_set.region, self.active_set.local.theta
        beyond = np.maximum(region.low - theta, theta - region.high) / active_set.local.spread
        return max(float(beyond.max(initial=0.0)), -float(active_set.eigenvalues.min(initial=0.0)))

    @property
    def gap(self) -> float:
        """Complementarity gap: multipliers times values of the active constraints, in chi-square."""
        return float(np.abs(self.multipliers) @ np.abs(self.active_set.values))

    @property
    def residual(self) -> float:
        """Residual of stationarity and complementarity, which Newton steps reduce, chi-square per std."""
        return self.slope + float(np.sqrt(self.gap))

    @property
    def exact(self) -> bool:
        """Whether the residual is only rounding."""
        return self.residual < ROUNDING_SHARE * (1 + float(np.linalg.norm(self._lagrange.slope)))

    @property
    def met(self) -> bool:
        """Whether the point is the minimum within rounding and the tolerance of a refit."""
        return max(self.residual, self.wrong_sign) < KKT_TOLERANCE and self.outside < FEASIBILITY_TOLERANCE


def sum_of_squares(active_set: ActiveSet, curved: Array | None = None) -> tuple[Array, Array]:
    """F (m, k), e (m,): chi-square and prior are |F d - e|² about the point, to second order.

    With a multiplier `curved` of v' J v, the curvature of the cone's boundary is added.
    """
    rows, targets = active_set.local.whole.root, active_set.local.whole.target
    if curved is None or not active_set.rank:
        return rows, targets
    curvature = active_set.curvature(curved)
    return np.concatenate([rows, curvature]), np.concatenate([targets, np.zeros(len(curvature))])
