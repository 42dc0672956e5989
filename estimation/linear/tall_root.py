"""Tall root: the triangle of a matrix with few columns and any number of rows, which is never there as a whole."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from estimation.linear.square_root import EPS, PLAIN

Array = NDArray[np.float64]

BLOCK = 4096
"""Samples that are worked on at once: with all that they are made of they stay in a processor's cache."""
SAMPLE = 24
"""Samples a column from which the scaling of all is taken: what is alike throughout keeps a condition of 2.3.

Columns that are independent lie between 1 - sqrt(1/24) and 1 + sqrt(1/24) of their length (Marchenko and Pastur).
"""
ALONE = 2**18
"""Multiplications in a product up to which OpenBLAS wakes no other thread: here they would only wait."""
GOLDEN = 0.6180339887498949
"""Steps of it fill an interval evenly and repeat with no period."""
DEPENDENT = 1e-12
"""Share of a column that has to be independent of the others to be scaled up: less is rounding."""


class Columns(ABC):
    """A matrix of n samples by w columns, held by what it can be made from."""

    samples: int
    width: int

    @abstractmethod
    def rows(self, start: int, end: int, out: Array) -> None:
        """Write the samples from start to end to `out` (w, end - start), one column a row."""

    @abstractmethod
    def at(self, index: NDArray[np.intp]) -> Array:
        """The samples of these numbers, (w, len(index))."""


def tall_root(columns: Columns) -> Array:
    """R (w, w) upper triangular with R'R = B'B, for B (n, w); of less than w samples with rows of zeros.

    B'B costs one product a block, and has lost the condition squared. A triangle S of some samples, spread over all,
    is found by Householder first; B S^-1 is then nearly orthonormal up to its length, its B'B = C'C is found without
    loss, and R = C S (randomised preconditioned Cholesky QR: Fan, Guo, Lin, arXiv:2111.11148, 2021; Balabanov,
    arXiv:2210.09953, 2022; its rounding is that of CholeskyQR2). What is large in a column and explained by the others,
    readings by the motion, is so taken away before anything is summed. Whether the condition is small is looked at, not
    assumed: where the samples were not like the rest, all blocks go through Householder.
    A value that is not finite makes R not finite.
    """
    count = min(SAMPLE * columns.width, columns.samples)
    sample = columns.at(_spread(columns.samples, count))
    first = householder(sample)
    if count == columns.samples or not np.isfinite(first).all():
        return first
    scaling = _scaling(first)
    product = _product(columns, scaling)
    if not np.isfinite(product).all():
        return np.full_like(first, np.nan)
    second = _cholesky(product)
    return _by_householder(columns) if second is None else np.asarray(second @ scaling)


def householder(rows: Array) -> Array:
    """R (w, w) of samples that are there, (w, n)."""
    width, samples = rows.shape
    if not np.isfinite(rows).all():
        return np.full((width, width), np.nan)
    root = np.linalg.qr(rows.T, mode="r")
    return np.pad(root, ((0, max(width - samples, 0)), (0, 0)))


def _spread(samples: int, count: int) -> NDArray[np.intp]:
    """Numbers of `count` samples, one of each of as many stretches, at places that have no common period."""
    place = np.arange(count)
    return np.asarray((place + (place * GOLDEN) % 1.0) * (samples / count), dtype=np.intp)


def _scaling(first: Array) -> Array:
    """S: the triangle, with a diagonal of which none is only rounding."""
    lengths = np.linalg.norm(first, axis=0)
    diagonal = np.diag(first)
    least = np.where(lengths > 0, DEPENDENT * lengths, 1.0)
    return np.asarray(first + np.diag(np.where(np.abs(diagonal) > least, 0.0, least - diagonal)))


def _product(columns: Columns, scaling: Array) -> Array:
    """(B S^-1)'(B S^-1), block by block."""
    width = columns.width
    inverse = np.linalg.inv(scaling).T.copy()  # of a triangle, elimination is back substitution
    block, piece = min(BLOCK, columns.samples), max(ALONE // width**2, 1)
    rows, total = np.empty((width, block)), np.zeros((width, width))
    for start in range(0, columns.samples, block):
        end = min(start + block, columns.samples)
        columns.rows(start, end, rows[:, : end - start])
        for begin in range(0, end - start, piece):
            scaled = inverse @ rows[:, begin : min(begin + piece, end - start)]
            total += scaled @ scaled.T
    return total


def _cholesky(product: Array) -> Array | None:
    """C upper triangular with C'C the product, exact to rounding; None where the product has lost too much."""
    lengths = np.sqrt(np.diag(product))
    kept = lengths > 0  # a column of zeros, such as a channel that reads nothing, has no part in the others
    scale = lengths[kept]
    root = np.zeros_like(product)
    try:
        found = np.linalg.cholesky(product[np.ix_(kept, kept)] / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        return None
    if found.size and np.linalg.cond(found) ** 2 * EPS > PLAIN:
        return None
    root[np.ix_(kept, kept)] = found * scale
    return root


def _by_householder(columns: Columns) -> Array:
    """The triangle of the triangles of all blocks."""
    block = min(BLOCK, columns.samples)
    root = np.zeros((columns.width, columns.width))
    rows = np.empty((columns.width, block))
    for start in range(0, columns.samples, block):
        part = rows[:, : min(block, columns.samples - start)]
        columns.rows(start, start + part.shape[1], part)
        root = householder(np.concatenate([root.T, part], axis=1))
    return root
