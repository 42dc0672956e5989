"""Karush-Kuhn-Tucker conditions at a point, with the multipliers that meet them best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.active_set import ActiveSet, smat
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

KKT_TOLERANCE = 2e-3
"""Slope of the chi-square, per std, below which a point is a minimum: a step from there gains less than 1e-6."""

FEASIBILITY_TOLERANCE = 1e-9
"""Largest admissible infeasibility: eigenvalues of J have a rounding of a few 1e-16 of its largest."""

ROUNDING_SHARE = 1e-9
"""Relative rounding of a gradient."""


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
    def _whitened(self) -> tuple[Array, Array, Array]:
        """Per std: the gradient (k,), the active set's normals scaled to unit norm (k, c), and their norms (c,)."""
        active_set = self.active_set
        normals = active_set.normals @ active_set.local.basis
        lengths = np.linalg.norm(normals, axis=1)
        sizes = np.where(lengths > 0, lengths, 1.0)
        return active_set.local.basis.T @ self.gradient, (normals / sizes[:, None]).T, sizes

    @cached_property
    def unit_multipliers(self) -> Array:
        """Multipliers (c,) of the active set's unit normals, chi-square per std, that fit the gradient best.

        With dependent normals (a mass at 0 by its bound and by the pseudo-inertia) multipliers are not unique. The
        simplest sufficient set is used: the bounds alone, the pseudo-inertia alone, it with the bounds independent of
        it, all.
        """
        slope, columns, sizes = self._whitened
        is_bound = np.arange(len(sizes)) < len(self.active_set.ends)
        independent = is_bound & ~_in_span(columns, columns[:, ~is_bound])
        subsets = (is_bound, ~is_bound, ~is_bound | independent, np.ones_like(is_bound))
        candidates = [self._on_subset(used) for used in subsets]
        residuals = [float(np.linalg.norm(slope - columns @ c)) + self._most_negative(c) for c in candidates]
        sufficient = 2 * min(residuals) + self._rounding
        return next(c for c, residual in zip(candidates, residuals, strict=True) if residual <= sufficient)

    def _on_subset(self, used: BoolArray) -> Array:
        """Multipliers of a subset of the normals, with the signs that they must have.

        A simple zero of the pseudo-inertia has a scalar multiplier: bounded least squares. A multiple zero has a
        positive semidefinite matrix, which the gradient may not determine: the one nearest to the cone program's that
        balances the gradient.
        """
        slope, columns, sizes = self._whitened
        found = np.zeros(len(used))
        if self.active_set.rank > 1 and used[len(self.active_set.ends) :].any():
            found[used] = (self.active_set.guess * sizes)[used]
            found[used] += np.linalg.lstsq(columns[:, used], slope - columns @ found)[0]
        elif used.any():
            from scipy.optimize import lsq_linear  # slow to import and rarely needed

            low = np.where(self.active_set.sign_free[used], -np.inf, 0.0)
            found[used] = lsq_linear(columns[:, used], slope, (low, np.inf), method="bvls", tol=1e-14).x
        return found

    def _most_negative(self, unit_multipliers: Array) -> float:
        """Size of the most negative of the multipliers (c,) of the inequalities, chi-square per std.

        Scaling rows and columns of a matrix alike preserves its inertia (signs of the eigenvalues).
        """
        ends, rank, sizes = len(self.active_set.ends), self.active_set.rank, self._whitened[2]
        signed = unit_multipliers[:ends][~self.active_set.sign_free[:ends]]
        size = np.sqrt(np.diag(smat(sizes[ends:], rank)))
        inner = np.linalg.eigvalsh(smat((unit_multipliers / sizes)[ends:], rank) * np.outer(size, size))
        return -float(min(signed.min(initial=0.0), inner.min(initial=0.0)))

    @property
    def _rounding(self) -> float:
        return ROUNDING_SHARE * (1 + float(np.linalg.norm(self._whitened[0])))

    @property
    def multipliers(self) -> Array:
        """(c,) multipliers in the order of the active set's normals, chi-square per unit."""
        return self.unit_multipliers / self._whitened[2]

    @property
    def inner(self) -> Array:
        """(rank, rank) multiplier of v' J v."""
        return smat(self.multipliers[len(self.active_set.ends) :], self.active_set.rank)

    @property
    def Z(self) -> Array:
        """(n, n) multiplier of J."""
        return np.asarray(self.active_set.null @ self.inner @ self.active_set.null.T)

    def bound_multipliers(self, *, lower: bool) -> Array:
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
        return self._most_negative(self.unit_multipliers)

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
        return self.residual < self._rounding

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


def _in_span(columns: Array, span: Array) -> BoolArray:
    """Which unit columns lie in the span of other columns."""
    left, singular, _ = np.linalg.svd(span, full_matrices=False)
    basis = left[:, singular > SINGULAR_VALUE_TOLERANCE]
    return np.asarray(np.linalg.norm(columns - basis @ (basis.T @ columns), axis=0) < np.sqrt(SINGULAR_VALUE_TOLERANCE))
