"""Linear least squares by scaled SVD: solution, covariance, condition number, identifiable parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import SquareRootInformation

Array = NDArray[np.float64]

UNIDENTIFIABLE_SHARE = 1e-3
"""Component in the null space, of columns of unit norm, from which on a parameter is unidentifiable."""


@dataclass(frozen=True, eq=False)
class ScaledSVD:
    """SVD of the rows of k parameters, columns scaled to unit norm, with its numerical rank.

    scale      (k,) norms of the columns, 1 for a column of zeros
    singular   (k,) descending
    left       (k, k) and `right` (k, k): root / scale = left diag(singular) right
    rounding   share of the largest singular value at which a direction is only rounding
    """

    scale: Array
    singular: Array
    left: Array
    right: Array
    rounding: float

    @classmethod
    def of(cls, root: Array, rounding: float, faint: float = 0.0) -> Self:
        """Of the R factor (k, k) of the rows, whose columns have the same norms and angles.

        Columns of norm up to `faint` count as zero: scaling them to unit norm would amplify rounding.
        """
        lengths = np.linalg.norm(root, axis=0)
        scale = np.where(lengths > faint, lengths, 1.0)
        left, singular, right = np.linalg.svd(np.where(lengths > faint, root, 0.0) / scale)
        return cls(scale, singular, left, right, rounding)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Identifiable directions: which rows of `right` have a singular value above rounding."""
        return np.asarray(self.singular > self.rounding * max(float(self.singular.max(initial=0.0)), 1e-300))

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the identifiable directions; 1 when the columns are orthogonal."""
        kept = self.singular[self.seen]
        return float(kept[0] / kept[-1]) if len(kept) else 1.0

    @property
    def unseen(self) -> Array:
        """Orthonormal basis (k, d) of the null space of the columns of unit norm."""
        return np.asarray(self.right[~self.seen].T)

    @cached_property
    def identifiable(self) -> NDArray[np.bool_]:
        """Identifiable parameters (k,): those without a component in the null space."""
        return np.asarray(np.linalg.norm(self.unseen, axis=1) < UNIDENTIFIABLE_SHARE)

    @cached_property
    def range(self) -> Array:
        """Projection (k, k) onto the range of R, of numerical rank."""
        kept = self.left[:, self.seen]
        return np.asarray(kept @ kept.T)

    @cached_property
    def inverse(self) -> Array:
        """Pseudo-inverse (k, k) of R: R^-1 on the identifiable directions, zero on the null space."""
        kept = self.seen
        return np.asarray((self.right[kept].T / self.singular[kept]) @ self.left[:, kept].T / self.scale[:, None])

    @cached_property
    def covariance(self) -> Array:
        """(R'R)^-1 (k, k) on the identifiable directions; the null space gets no variance."""
        return np.asarray(self.inverse @ self.inverse.T)


def least_squares_solution(information: SquareRootInformation, *, rounding: float, faint: float = 0.0) -> Array:
    """The minimiser (k,) of |R x - z| where R is more than rounding, with no component in its null space."""
    return np.asarray(ScaledSVD.of(information.root, rounding, faint).inverse @ information.target)
