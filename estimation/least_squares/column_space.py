"""Column space of a whitened derivative: orthonormal basis and least-squares coefficients in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import qr_factors
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE

Array = NDArray[np.float64]


def orthonormal_basis(derivative: Array) -> Array:
    """Orthonormal basis (rows, r) of the columns of a derivative, whatever their units."""
    return ColumnSpace.of(derivative).basis


@dataclass(frozen=True, eq=False)
class ColumnSpace:
    """Column space of a derivative D (rows, k) by its SVD: D / scale = basis diag(singular) right.

    scale     (k,) norms of the columns; `kept` (k',) are the columns whose norm is not 0
    basis     (rows, r) orthonormal to 1e-11, `singular` (r,) and `right` (r, k'); singular values below
              `SINGULAR_VALUE_TOLERANCE` of the largest are rounding
    """

    scale: Array
    kept: NDArray[np.intp]
    basis: Array
    singular: Array
    right: Array

    @classmethod
    def of(cls, derivative: Array) -> ColumnSpace:
        """By the SVD of the R factor of the scaled columns."""
        scale = np.linalg.norm(derivative, axis=0)
        kept = np.flatnonzero(scale > 0)
        if len(derivative) < len(kept):
            derivative = np.pad(derivative, ((0, len(kept) - len(derivative)), (0, 0)))
        factors = qr_factors(derivative[:, kept] / scale[kept])
        left, singular, right = np.linalg.svd(factors.root)
        regular = singular > SINGULAR_VALUE_TOLERANCE * singular.max(initial=0.0)
        return cls(scale, kept, factors.span(left[:, regular]), singular[regular], right[regular])

    def amounts(self, columns: Array) -> Array:
        """Least-squares coefficients (k, a) of the derivative's columns for other columns (rows, a)."""
        found = np.zeros((len(self.scale), columns.shape[1]))
        inner = self.right.T @ ((self.basis.T @ columns) / self.singular[:, None])
        found[self.kept] = inner / self.scale[self.kept, None]
        return found
