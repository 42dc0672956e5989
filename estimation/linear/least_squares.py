"""Least squares: the unknowns of whitened rows, their covariance, and what the rows do not show of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.linear.square_root import Method, SquareRoot, factored

Array = NDArray[np.float64]
LongArray = NDArray[np.longdouble]

MOST_REFINEMENTS = 10
"""Each gains the digits of 1 / (kappa eps); more than a few are only taken where there are hardly any to gain."""
PART = 1e-3
"""Part in an unseen direction, of columns of unit length, from which on an unknown is not shown."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What rows show of their k unknowns: singular values of the columns scaled to unit length.

    scale      (k,) lengths of the columns, 1 for a column of zeros
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
        """Of an upper triangle R (k, k) in place of the rows: its columns have their lengths and angles.

        Columns up to the length `faint` count as zero: unit length would make much of what is rounding altogether.
        """
        lengths = np.linalg.norm(root, axis=0)
        scale = np.where(lengths > faint, lengths, 1.0)
        left, singular, right = np.linalg.svd(np.where(lengths > faint, root, 0.0) / scale)
        return cls(scale, singular, left, right, rounding)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Which directions (the rows of `right`) are more than rounding."""
        return np.asarray(self.singular > self.rounding * max(float(self.singular.max(initial=0.0)), 1e-300))

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the directions that are seen; 1 when the columns are orthogonal."""
        kept = self.singular[self.seen]
        return float(kept[0] / kept[-1]) if len(kept) else 1.0

    @property
    def unseen(self) -> Array:
        """Orthonormal directions (k, d), of columns of unit length, that change nothing in any row."""
        return np.asarray(self.right[~self.seen].T)

    @cached_property
    def shown(self) -> NDArray[np.bool_]:
        """Which unknowns (k,) have no part in an unseen direction."""
        return np.asarray(np.linalg.norm(self.unseen, axis=1) < PART)

    @cached_property
    def range(self) -> Array:
        """Projection (k, k) onto what R can reach by what is seen."""
        kept = self.left[:, self.seen]
        return np.asarray(kept @ kept.T)

    @cached_property
    def inverse(self) -> Array:
        """R^-1 (k, k) on what is seen, zero on what is not."""
        kept = self.seen
        return np.asarray((self.right[kept].T / self.singular[kept]) @ self.left[:, kept].T / self.scale[:, None])

    @cached_property
    def covariance(self) -> Array:
        """(R'R)^-1 (k, k) on what is seen; unseen directions get no variance."""
        return np.asarray(self.inverse @ self.inverse.T)


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares solution of rows with noise of unit variance.

    theta       (k,) unknowns; along unseen directions they do not move from zero
    covariance  (k, k) without those directions
    power       sum of squares of what is left
    rows        number of rows, and `method` how they were brought to a triangle
    sight       what is seen of the unknowns
    Nothing is regularised: `unseen` says what has been left out, and `shown` which unknowns that touches.
    """

    theta: Array
    power: float
    rows: int
    method: Method
    sight: Sight

    @classmethod
    def of(cls, information: SquareRoot, *, rounding: float, faint: float = 0.0) -> Self:
        """From square-root information: R x = z where R is more than rounding."""
        sight = Sight.of(information.root, rounding, faint)
        theta = sight.inverse @ information.target
        left = information.target - information.root @ theta
        power = information.power + float(left @ left)
        return cls(theta, power, information.rows, information.method, sight)

    @property
    def covariance(self) -> Array:
        """Covariance (k, k) when the noise has unit variance."""
        return self.sight.covariance

    @property
    def condition(self) -> float:
        """Condition number of the columns scaled to unit length."""
        return self.sight.condition

    @property
    def unseen(self) -> Array:
        """Directions (k, d), of columns of unit length, that the rows do not show."""
        return self.sight.unseen

    @property
    def variance(self) -> float:
        """Power over degrees of freedom: the variance of a row, where rows were not whitened."""
        return self.power / max(self.rows - int(self.sight.seen.sum()), 1)


def solve(columns: Array, target: Array, *, method: Method | None = None, rounding: float | None = None) -> Solution:
    """Least squares of columns A (n, k) and target b (n,), exact to the last digits that the columns allow.

    The solution and its residual r satisfy r + A x = b, A'r = 0 (the augmented system). Both are refined with the
    errors f = b - r - A x and g = -A'r of these equations, found in extended precision: with A = Q R,
    u = R'^-1 g, dx = R^-1 (Q'f - u), dr = f - Q (Q'f - u) on what is seen (Björck, BIT 7, 1967). The error that
    remains does not grow with the condition squared when the residual is large. (NumPy's `longdouble` has 64 bits on
    x86 and 113 on ARM under Linux; where it is a double, refinement still takes out what the factors have lost.)
    `rounding` is the share of the largest singular value below which a direction is not seen, n eps unless given.
    """
    if len(columns) < columns.shape[1]:
        short = columns.shape[1] - len(columns)
        found = solve(np.pad(columns, ((0, short), (0, 0))), np.pad(target, (0, short)), method=method)
        return replace(found, rows=len(target))
    factors = factored(columns, method)
    sight = Sight.of(factors.root, len(columns) * np.finfo(float).eps if rounding is None else rounding)
    exact = columns.astype(np.longdouble)
    theta: LongArray = np.zeros(columns.shape[1], dtype=np.longdouble)
    residual: LongArray = np.zeros(len(columns), dtype=np.longdouble)
    last = np.inf
    for _ in range(MOST_REFINEMENTS):
        f = np.asarray(target - residual - exact @ theta, dtype=np.float64)
        u = sight.inverse.T @ np.asarray(-(exact.T @ residual), dtype=np.float64)
        inside = sight.range @ (factors.coordinates(f) - u)
        step = sight.inverse @ inside
        size = float(np.linalg.norm(step * sight.scale))
        if size > last / 2:  # no digit is gained any more
            break
        theta = np.asarray(theta + step)
        residual, last = np.asarray(residual + f - factors.span(inside)), size
    power = float(residual @ residual)
    return Solution(np.asarray(theta, dtype=np.float64), power, len(target), factors.method, sight)
