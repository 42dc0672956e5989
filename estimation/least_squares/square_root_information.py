"""Square-root information (R, z) of whitened rows; information of independent rows adds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from modeling.identifiability import ScaledSVD

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
    factors = _by_cholesky(columns)
    if factors is not None:
        return factors
    scale = _scale(np.linalg.norm(columns, axis=0))
    scaled: Array = columns / scale
    basis, root = (np.asarray(factor, dtype=np.float64) for factor in np.linalg.qr(scaled))
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


def least_squares_solution(information: SquareRootInformation, *, rounding: float, faint: float = 0.0) -> Array:
    """The minimiser (k,) of |R x - z| where R is more than rounding, with no component in its null space."""
    return np.asarray(ScaledSVD.of(information.root, rounding, faint).inverse @ information.target)


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
        amounts, svd = np.zeros((len(self.kept), columns.shape[1])), self.scaled_svd
        inner = svd.right[svd.regular].T @ ((self.basis.T @ columns) / svd.singular[svd.regular, None])
        amounts[self.kept] = inner / svd.scale[:, None]
        return amounts


# R factor of a tall matrix given by blocks of rows: randomised preconditioned Cholesky QR.


SAMPLES_PER_BLOCK = 16384
"""Samples per block: with the signals that they are computed from they fit in a processor's cache."""
SAMPLED_ROWS_PER_COLUMN = 24
"""Samples per column from which the preconditioner is computed: rows that are alike throughout get a condition of 2.3.

Singular values of independent columns lie between 1 - sqrt(1/24) and 1 + sqrt(1/24) (Marchenko and Pastur).
"""
SINGLE_THREAD_PRODUCT = 2**18
"""Multiplications in a product up to which OpenBLAS starts no other thread, which would only wait here."""
GOLDEN_RATIO = 0.6180339887498949
"""Multiples of it modulo 1 fill the interval evenly (low-discrepancy), without a period."""
WELL_CONDITIONED = 16.0
"""Condition, of columns of unit length, whose square times the rounding is as good as the rounding."""
DEPENDENCE_TOLERANCE = 1e-12
"""Share of a column independent of the others below which it is rounding and not scaled up."""


class TallMatrix(ABC):
    """A matrix of n samples by w columns, computed by blocks."""

    samples: int
    width: int

    @abstractmethod
    def rows(self, start: int, end: int, out: Array) -> None:
        """Write the samples from start to end to `out` (w, end - start), one column a row."""

    @abstractmethod
    def at(self, index: NDArray[np.intp]) -> Array:
        """The samples at `index`, (w, len(index))."""


def tall_matrix_r_factor(columns: TallMatrix) -> Array:
    """R (w, w) upper triangular with R'R = B'B, for B (n, w); with fewer than w samples it has rows of zeros.

    B'B costs one product per block, but its rounding is the condition squared. An R factor S of samples spread over the
    whole record is therefore computed first by Householder; B S^-1 is then nearly orthonormal, its Gram
    matrix C'C is accurate, and R = C S (randomised preconditioned Cholesky QR: Fan, Guo, Lin, arXiv:2111.11148, 2021;
    Balabanov, arXiv:2210.09953, 2022; its rounding is that of CholeskyQR2). What is large in a column and explained by
    the others, readings by the motion, is thus removed before anything is summed; leading columns that are well
    conditioned by themselves stay as they are. The condition is checked, not assumed: where the samples are not
    representative, all blocks are factorised by Householder.
    A non-finite value makes R non-finite.
    """
    count = min(SAMPLED_ROWS_PER_COLUMN * columns.width, columns.samples)
    sample = columns.at(_spread_samples(columns.samples, count))
    first = householder_r_factor(sample)
    if count == columns.samples or not np.isfinite(first).all():
        return first
    kept = _well_conditioned_columns(first)
    scaling = _preconditioner(first, kept)
    product = _preconditioned_gram(columns, scaling, kept)
    if not np.isfinite(product).all():
        return np.full_like(first, np.nan)
    second = _cholesky(product)
    return _by_householder(columns) if second is None else np.asarray(second @ scaling)


def householder_r_factor(rows: Array) -> Array:
    """R (w, w) of samples in memory, (w, n), by Householder."""
    width, samples = rows.shape
    if not np.isfinite(rows).all():
        return np.full((width, width), np.nan)
    root = np.linalg.qr(rows.T, mode="r")
    return np.pad(root, ((0, max(width - samples, 0)), (0, 0)))


def _spread_samples(samples: int, count: int) -> NDArray[np.intp]:
    """Indices of `count` samples, one in each of as many intervals, at positions without a common period."""
    place = np.arange(count)
    return np.asarray((place + (place * GOLDEN_RATIO) % 1.0) * (samples / count), dtype=np.intp)


def _well_conditioned_columns(first: Array) -> int:
    """Number of leading columns whose R factor, scaled to unit length, is well conditioned; it grows with each."""

    def condition(count: int) -> float:
        leading = first[:count, :count]
        lengths = np.linalg.norm(leading, axis=0)
        return float(np.linalg.cond(leading / lengths)) if lengths.all() else np.inf

    return bisect_right(range(1, len(first) + 1), WELL_CONDITIONED, key=condition)


def _preconditioner(first: Array, kept: int) -> Array:
    """S: the R factor of the samples, its diagonal raised above rounding; the `kept` columns as they are."""
    lengths = np.linalg.norm(first, axis=0)
    diagonal = np.diag(first)
    least = np.where(lengths > 0, DEPENDENCE_TOLERANCE * lengths, 1.0)
    scaling = first + np.diag(np.where(np.abs(diagonal) > least, 0.0, least - diagonal))
    scaling[:kept] = np.linalg.solve(scaling[:kept, :kept], scaling[:kept])
    scaling[:kept, :kept] = np.eye(kept)
    return np.asarray(scaling)


def _preconditioned_gram(columns: TallMatrix, scaling: Array, kept: int) -> Array:
    """(B S^-1)'(B S^-1), block by block."""
    width = columns.width
    inverse = np.linalg.inv(scaling).T[kept:].copy()  # for a triangular matrix, LU is back substitution
    block, piece = min(SAMPLES_PER_BLOCK, columns.samples), max(SINGLE_THREAD_PRODUCT // width**2, 1)
    rows, total = np.empty((width, block)), np.zeros((width, width))
    for start in range(0, columns.samples, block):
        end = min(start + block, columns.samples)
        columns.rows(start, end, rows[:, : end - start])
        for begin in range(0, end - start, piece):
            filled = rows[:, begin : min(begin + piece, end - start)]
            if kept < width:
                filled[kept:] = inverse @ filled
            total += filled @ filled.T
    return total


def _cholesky(product: Array) -> Array | None:
    """C upper triangular with C'C the product, exact to rounding; None where the product is ill-conditioned."""
    lengths = np.sqrt(np.diag(product))
    kept = lengths > 0  # a column of zeros, such as a dead channel, is left out
    scale = lengths[kept]
    root = np.zeros_like(product)
    try:
        factor = np.linalg.cholesky(product[np.ix_(kept, kept)] / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        return None
    if factor.size and np.linalg.cond(factor) ** 2 * EPS > CHOLESKY_ROUNDING:
        return None
    root[np.ix_(kept, kept)] = factor * scale
    return root


def _by_householder(columns: TallMatrix) -> Array:
    """R factor by Householder, block by block."""
    block = min(SAMPLES_PER_BLOCK, columns.samples)
    root = np.zeros((columns.width, columns.width))
    rows = np.empty((columns.width, block))
    for start in range(0, columns.samples, block):
        filled = rows[:, : min(block, columns.samples - start)]
        columns.rows(start, start + filled.shape[1], filled)
        root = householder_r_factor(np.concatenate([root.T, filled], axis=1))
    return root
