"""Lagrange multipliers of an active set by signed least squares on the gradient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.active_set import ActiveSet, smat
from estimation.least_squares.levenberg_marquardt import SINGULAR_VALUE_TOLERANCE

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ROUNDING_SHARE = 1e-9
"""Relative rounding of a gradient."""


@dataclass(frozen=True, eq=False)
class LagrangeMultipliers:
    """Gradient and normals of the active set in whitened parameters, and the multipliers that balance them.

    slope    (k,) gradient of chi-square and prior, per std
    columns  (k, c) the active set's normals, scaled to unit norm
    sizes    (c,) their norms before scaling
    """

    active_set: ActiveSet
    slope: Array
    columns: Array
    sizes: Array

    @classmethod
    def of(cls, active_set: ActiveSet, gradient: Array) -> Self:
        """From a gradient (k,) in the parameters."""
        normals = active_set.normals @ active_set.local.basis
        lengths = np.linalg.norm(normals, axis=1)
        sizes = np.where(lengths > 0, lengths, 1.0)
        return cls(active_set, active_set.local.basis.T @ gradient, (normals / sizes[:, None]).T, sizes)

    @cached_property
    def unit_multipliers(self) -> Array:
        """Multipliers (c,) of the unit normals, chi-square per std, that fit the gradient best.

        With dependent normals (a mass at 0 by its bound and by the pseudo-inertia) multipliers are not unique. The
        simplest sufficient set is used: the bounds alone, the pseudo-inertia alone, it with the bounds independent of
        it, all.
        """
        is_bound = np.arange(len(self.sizes)) < len(self.active_set.ends)
        independent = is_bound & ~_in_span(self.columns, self.columns[:, ~is_bound])
        every = np.ones_like(is_bound)
        subsets = (is_bound, ~is_bound, ~is_bound | independent, every)
        candidates = [(found, self._residual(found)) for found in map(self._on_subset, subsets)]
        rounding = ROUNDING_SHARE * (1 + float(np.linalg.norm(self.slope)))
        sufficient = 2 * min(residual for _, residual in candidates) + rounding
        return next(found for found, residual in candidates if residual <= sufficient)

    def _on_subset(self, used: BoolArray) -> Array:
        """Multipliers of a subset of the normals, with the signs that they must have.

        A simple zero of the pseudo-inertia has a scalar multiplier: non-negative least squares. A multiple zero has a
        positive semidefinite matrix, which the gradient may not determine: the one nearest to the cone program's that
        balances the gradient.
        """
        found = np.zeros(len(used))
        if self.active_set.rank > 1 and used[len(self.active_set.ends) :].any():
            found[used] = (self.active_set.guess * self.sizes)[used]
            found[used] += np.linalg.lstsq(self.columns[:, used], self.slope - self.columns @ found)[0]
            return found
        both = used & self.active_set.sign_free
        signed = np.concatenate([self.columns[:, used], -self.columns[:, both]], axis=1)
        if signed.size:
            from scipy.optimize import nnls  # slow to import and rarely needed

            values, _ = nnls(signed, self.slope)
            found[used] = values[: used.sum()]
            found[both] -= values[used.sum() :]
        return found

    def _residual(self, unit_multipliers: Array) -> float:
        """Norm of the gradient of the Lagrangian plus dual infeasibility."""
        return float(np.linalg.norm(self.slope - self.columns @ unit_multipliers)) + self.wrong_sign(unit_multipliers)

    def wrong_sign(self, unit_multipliers: Array) -> float:
        """Dual infeasibility: size of the most negative multiplier (c,) of an inequality, chi-square per std.

        Scaling rows and columns of a matrix alike preserves its inertia (signs of the eigenvalues).
        """
        ends, rank = len(self.active_set.ends), self.active_set.rank
        signed = unit_multipliers[:ends][~self.active_set.sign_free[:ends]]
        size = np.sqrt(np.diag(smat(self.sizes[ends:], rank)))
        inner = np.linalg.eigvalsh(smat((unit_multipliers / self.sizes)[ends:], rank) * np.outer(size, size))
        return -float(min(signed.min(initial=0.0), inner.min(initial=0.0)))


def _in_span(columns: Array, span: Array) -> BoolArray:
    """Which unit columns lie in the span of other columns."""
    left, singular, _ = np.linalg.svd(span, full_matrices=False)
    basis = left[:, singular > SINGULAR_VALUE_TOLERANCE]
    return np.asarray(np.linalg.norm(columns - basis @ (basis.T @ columns), axis=0) < np.sqrt(SINGULAR_VALUE_TOLERANCE))
