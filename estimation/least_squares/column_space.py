"""Column space of a whitened derivative: orthonormal basis and least-squares coefficients in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import qr_factors
from modeling.identifiability import ScaledSVD

Array = NDArray[np.float64]


def orthonormal_basis(derivative: Array) -> Array:
    """Orthonormal basis (rows, r) of the columns of a derivative, whatever their units."""
    return ColumnSpace.of(derivative).basis


@dataclass(frozen=True, eq=False)
class ColumnSpace:
    """Column space of a derivative D (rows, k).

    kept        (k,) the columns whose norm is not 0
    basis       (rows, r) orthonormal to 1e-11
    scaled_svd  of the R factor of the columns that are kept
    """

    kept: NDArray[np.bool_]
    basis: Array
    scaled_svd: ScaledSVD

    @classmethod
    def of(cls, derivative: Array) -> ColumnSpace:
        """By the QR factors of the columns and the scaled SVD of R."""
        kept = np.einsum("ij,ij->j", derivative, derivative) > 0
        columns = derivative if kept.all() else derivative[:, kept]
        if len(columns) < columns.shape[1]:
            columns = np.pad(columns, ((0, columns.shape[1] - len(columns)), (0, 0)))
        factors = qr_factors(columns)
        scaled_svd = ScaledSVD.of(factors.root)
        return cls(kept, factors.span(scaled_svd.left[:, scaled_svd.regular])[: len(derivative)], scaled_svd)

    def amounts(self, columns: Array) -> Array:
        """Least-squares coefficients (k, a) of the derivative's columns for other columns (rows, a)."""
        found, svd = np.zeros((len(self.kept), columns.shape[1])), self.scaled_svd
        inner = svd.right[svd.regular].T @ ((self.basis.T @ columns) / svd.singular[svd.regular, None])
        found[self.kept] = inner / svd.scale[:, None]
        return found
