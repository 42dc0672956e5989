"""R factor of a tall matrix given by blocks of rows: randomised preconditioned Cholesky QR."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import CHOLESKY_ROUNDING, EPS

Array = NDArray[np.float64]

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
        part = first[:count, :count]
        lengths = np.linalg.norm(part, axis=0)
        return float(np.linalg.cond(part / lengths)) if lengths.all() else np.inf

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
            part = rows[:, begin : min(begin + piece, end - start)]
            if kept < width:
                part[kept:] = inverse @ part
            total += part @ part.T
    return total


def _cholesky(product: Array) -> Array | None:
    """C upper triangular with C'C the product, exact to rounding; None where the product is ill-conditioned."""
    lengths = np.sqrt(np.diag(product))
    kept = lengths > 0  # a column of zeros, such as a dead channel, is left out
    scale = lengths[kept]
    root = np.zeros_like(product)
    try:
        found = np.linalg.cholesky(product[np.ix_(kept, kept)] / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        return None
    if found.size and np.linalg.cond(found) ** 2 * EPS > CHOLESKY_ROUNDING:
        return None
    root[np.ix_(kept, kept)] = found * scale
    return root


def _by_householder(columns: TallMatrix) -> Array:
    """R factor by Householder, block by block."""
    block = min(SAMPLES_PER_BLOCK, columns.samples)
    root = np.zeros((columns.width, columns.width))
    rows = np.empty((columns.width, block))
    for start in range(0, columns.samples, block):
        part = rows[:, : min(block, columns.samples - start)]
        columns.rows(start, start + part.shape[1], part)
        root = householder_r_factor(np.concatenate([root.T, part], axis=1))
    return root
