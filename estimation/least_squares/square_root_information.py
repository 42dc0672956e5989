"""Square-root information (R, z) of whitened rows; information of independent rows adds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

Array = NDArray[np.float64]

CHOLESKY_ROUNDING = 1e-11
"""kappa² eps, the relative rounding of the information, up to which one Cholesky factorisation is enough."""
ORTHONORMALITY_TOLERANCE = 0.1
"""Distance of Q'Q from 1 below which Q's condition is under 1.1, so that a second Cholesky is exact to rounding."""
EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class QRFactors:
    """Columns A (n, k) as Q R: R = `root` (k, k) upper triangular, Q = `basis` `inner`^-1 orthonormal.

    basis  (n, k) and `inner` (k, k), upper triangular: A and R themselves, or columns that are nearly orthonormal and
           the factor that corrects them
    """

    basis: Array
    inner: Array
    root: Array

    def coordinates(self, vector: Array) -> Array:
        """Q' v, (k,)."""
        return np.asarray(
            scipy.linalg.solve_triangular(self.inner, self.basis.T @ vector, trans="T", check_finite=False)
        )

    def span(self, coordinates: Array) -> Array:
        """Q c, (n,)."""
        return np.asarray(self.basis @ scipy.linalg.solve_triangular(self.inner, coordinates, check_finite=False))

    def split(self, target: Array) -> tuple[Array, Array]:
        """Coordinates Q' b (k,), and b - Q Q' b (n,); projected twice, so that the residual is orthogonal to Q."""
        first = self.coordinates(target)
        residual = target - self.span(first)
        second = self.coordinates(residual)
        return first + second, residual - self.span(second)


def qr_factors(columns: Array) -> QRFactors:
    """QR factors of columns A (n, k), n >= k, by the quickest method that is accurate enough.

    Products of tall matrices are several times faster than Householder's reflections, but A'A = R'R has lost the
    condition squared: R is exact to kappa² eps, kappa the condition of the columns scaled to unit norm. Below
    `CHOLESKY_ROUNDING` that is enough, since the coordinates are refined with the residual in A itself (corrected
    seminormal equations: Björck, Linear Algebra Appl. 88/89, 1987). Above, Q1 = A R^-1 has Q1'Q1 = 1 + O(kappa² eps),
    and while that is close to 1, up to kappa of about 1e7, a second Cholesky, of Q1'Q1, makes R = R2 R1 exact to
    rounding (CholeskyQR2: Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, ETNA 44, 2015). This is checked, not assumed.
    Otherwise Householder, with an `inner` of one.
    """
    found = _by_cholesky(columns)
    if found is not None:
        return found
    scale = _scale(np.linalg.norm(columns, axis=0))
    scaled: Array = columns / scale
    basis, root = (np.asarray(part, dtype=np.float64) for part in np.linalg.qr(scaled))
    return QRFactors(basis, np.eye(len(scale), dtype=np.float64), np.asarray(root * scale))


def _by_cholesky(columns: Array) -> QRFactors | None:
    gram = columns.T @ columns
    scale = _scale(np.sqrt(np.diag(gram)))
    try:
        first = np.linalg.cholesky(gram / np.outer(scale, scale)).T * scale
        if np.linalg.cond(first / np.linalg.norm(first, axis=0)) ** 2 * EPS < CHOLESKY_ROUNDING:
            return QRFactors(columns, first, first)
        basis: Array = np.asarray(scipy.linalg.blas.dtrsm(1.0, first, columns.T, trans_a=1).T)
        gram = basis.T @ basis
        if not np.linalg.norm(gram - np.eye(len(gram))) < ORTHONORMALITY_TOLERANCE:  # or not finite
            return None
        second: Array = np.asarray(np.linalg.cholesky(gram).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return QRFactors(basis, second, second @ first)


def _scale(lengths: Array) -> Array:
    """Powers of two nearest to the columns' norms, which scale without rounding; 1 for a zero column."""
    return np.asarray(np.exp2(np.round(np.log2(np.where(lengths > 0, lengths, 1.0)))), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SquareRootInformation:
    """Sufficient statistic of whitened rows A x = b for least squares: |A x - b|² = |R x - z|² + power.

    root    (k, k) upper triangular R, R'R = A'A the Fisher information
    target  (k,) z
    power   residual sum of squares at the minimum
    rows    number of rows, less the parameters eliminated
    Information adds: (R1 z1; R2 z2) of two sets of rows is stacked and factorised again (Bierman,
    Factorization Methods for Discrete Sequential Estimation, 1977), in any order and grouping.
    """

    root: Array
    target: Array
    power: float
    rows: int

    @classmethod
    def of(cls, columns: Array, target: Array) -> Self:
        """Of whitened rows: columns (n, k) and target (n,)."""
        short = columns.shape[1] - len(columns)
        filled = np.pad(columns, ((0, short), (0, 0))) if short > 0 else columns
        factors = qr_factors(filled)
        coordinates, residual = factors.split(np.pad(target, (0, short)) if short > 0 else target)
        return cls(factors.root, coordinates, float(residual @ residual), len(target))

    @classmethod
    def of_triangle(cls, rows: Array, count: int) -> SquareRootInformation:
        """Of `count` rows given by the R factor `rows` (m, k + 1) of (A b)."""
        return _triangularised(rows, 0.0, count)

    @classmethod
    def empty(cls, size: int) -> Self:
        """Of no rows: the neutral element of addition."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0, 0)

    @property
    def cost(self) -> float:
        """Chi-square at x = 0, |b|²."""
        return float(self.target @ self.target) + self.power

    def __add__(self, other: SquareRootInformation) -> SquareRootInformation:
        """Information of both sets of rows."""
        stacked = np.vstack([np.column_stack([s.root, s.target]) for s in (self, other)])
        return _triangularised(stacked, self.power + other.power, self.rows + other.rows)

    def shifted(self, step: Array) -> SquareRootInformation:
        """Of the same rows, with the origin of x moved to `step` (k,)."""
        return replace(self, target=self.target - self.root @ step)

    def damped(self, strength: float) -> SquareRootInformation:
        """With Levenberg damping: a further row per parameter, `strength` times its column's norm, with target 0."""
        lengths = np.linalg.norm(self.root, axis=0)
        rows = np.diag(strength * np.where(lengths > 0, lengths, 1.0))
        return self + SquareRootInformation(rows, np.zeros(len(rows)), 0.0, 0)

    def restricted(self, kept: NDArray[np.bool_] | NDArray[np.intp]) -> SquareRootInformation:
        """On a subset of the parameters, the others fixed at 0; an index also reorders."""
        return _triangularised(np.column_stack([self.root[:, kept], self.target]), self.power, self.rows)

    def spread(self, index: NDArray[np.intp], size: int) -> SquareRootInformation:
        """As information on `size` parameters, of which these are at the positions `index`."""
        wide = np.zeros((len(self.target), size))
        wide[:, index] = self.root
        return _triangularised(np.column_stack([wide, self.target]), self.power, self.rows)

    def eliminated(self, count: int) -> SquareRootInformation:
        """On all but the first `count` parameters, minimised over those.

        |R x - z|² = |R11 x1 + R12 x2 - z1|² + |R22 x2 - z2|²; x1 makes the first term vanish for every x2.
        """
        return replace(
            self,
            root=self.root[count:, count:],
            target=self.target[count:],
            rows=self.rows - count,
        )


def _triangularised(stacked: Array, power: float, rows: int) -> SquareRootInformation:
    """Information of rows (R z) and the residual power of others, to which this factorisation adds its own residual."""
    size = stacked.shape[1] - 1
    short = max(0, size + 1 - len(stacked))
    filled = np.vstack([stacked, np.zeros((short, size + 1))]) if short else stacked
    root = np.asarray(np.linalg.qr(filled, mode="r"))
    return SquareRootInformation(root[:size, :size], root[:size, size], power + float(root[size, size] ** 2), rows)
