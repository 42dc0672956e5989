"""Directions: what the columns of a whitened derivative span, and what a fit's own parameters do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.linear.square_root import factored

Array = NDArray[np.float64]


def orthonormal(derivative: Array) -> Array:
    """Orthonormal basis (rows, r) of the columns of a derivative, whatever their units."""
    return Directions.of(derivative).basis


@dataclass(frozen=True, eq=False)
class Directions:
    """What the columns of a derivative D (rows, k) span: D / scale = basis diag(singular) right.

    scale     (k,) lengths of the columns; those of length 0 are left out, `kept` (k',) are the others
    basis     (rows, r) orthonormal to 1e-11, `singular` (r,) and `right` (r, k'); a billionth of the
              largest is rounding
    """

    scale: Array
    kept: NDArray[np.intp]
    basis: Array
    singular: Array
    right: Array

    @classmethod
    def of(cls, derivative: Array) -> Directions:
        """By the singular values of the columns' triangle."""
        scale = np.linalg.norm(derivative, axis=0)
        kept = np.flatnonzero(scale > 0)
        if len(derivative) < len(kept):
            derivative = np.pad(derivative, ((0, len(kept) - len(derivative)), (0, 0)))
        factors = factored(derivative[:, kept] / scale[kept])
        left, singular, right = np.linalg.svd(factors.root)
        shown = singular > 1e-9 * singular.max(initial=0.0)
        return cls(scale, kept, factors.span(left[:, shown]), singular[shown], right[shown])

    def amounts(self, columns: Array) -> Array:
        """Least-squares amounts (k, a) of the derivative's columns that imitate other columns (rows, a) best."""
        found = np.zeros((len(self.scale), columns.shape[1]))
        inner = self.right.T @ ((self.basis.T @ columns) / self.singular[:, None])
        found[self.kept] = inner / self.scale[self.kept, None]
        return found


@dataclass(frozen=True, eq=False)
class Spanned:
    """A fit's whitened residual (rows,), the rows that its parameters reach, and their `directions` in those."""

    residual: Array
    reached: slice | NDArray[np.intp]
    directions: Directions

    @property
    def leverage(self) -> Array:
        """How much of each row the fit has soaked up, (rows,)."""
        found = np.zeros(len(self.residual))
        found[self.reached] = np.einsum("ij,ij->i", self.directions.basis, self.directions.basis)
        return found


@lru_cache(maxsize=1)
def spanned(fit: Fit) -> Spanned:
    """What a fit's parameters span; of the last fit it is kept, as whoever judges a fit asks more than once.

    The derivative itself is as large as all else, and nobody needs it again.
    """
    linearised = fit.linearised()
    return Spanned(linearised.residual, linearised.reached, Directions.of(linearised.derivative))
