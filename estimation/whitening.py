"""Whitening: from series of readings to rows of unit variance, independent under the noise alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import solve_triangular

from estimation.response import Response

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

MOST_NUMBERS = 500_000
"""Numbers that are transformed together: their lines and rows take some 20 MB."""


class Whitener(ABC):
    """A linear map from a series (n, p) of readings to real rows of unit variance under the noise.

    The first `steady_rows` rows carry everything that repeats with the motion; what does not repeat reaches all.
    """

    rows: int
    steady_rows: int

    @abstractmethod
    def series(self, values: Array) -> Array:
        """Rows (rows, ...) of a series over the whole record (n, p, ...)."""

    @abstractmethod
    def steady(self, values: Array) -> Array:
        """Rows (steady_rows, ...) of one repeat of a periodic series (n / repeats, p, ...)."""

    def rest(self, values: Array) -> Array:
        """Rows (rows - steady_rows, ...) of a series over the whole record, which nothing periodic reaches."""
        return self.series(values)[self.steady_rows :]

    def reached(self, response: Response) -> Array:
        """Rows (r, 1 + k) of a predicted value and of its derivative, r those that it reaches.

        They are the first `steady_rows` where all of it repeats with the motion, else all rows.
        """
        steady = self.steady(_joined(response.periodic))
        if response.whole is None:
            return steady
        passing = self.series(_joined(response.whole))
        if response.columns is None or len(response.columns) == steady.shape[-1] - 1:
            rows = passing
        else:
            rows = np.zeros((self.rows, *steady.shape[1:]))
            rows[..., [0, *(1 + i for i in response.columns)]] = passing
        rows[: self.steady_rows] += steady
        return rows

    def response(self, response: Response) -> tuple[Array, Array]:
        """Rows of a predicted value, (rows,), and of its derivative, (rows, k)."""
        reached = self.reached(response)
        rows = np.zeros((self.rows, *reached.shape[1:]))
        rows[: len(reached)] = reached
        return rows[..., 0], rows[..., 1:]


def _joined(part: tuple[Array, Array]) -> Array:
    """A value (n, p, ...) and its derivative (n, p, ..., k) as one series (n, p, ..., 1 + k), transformed at once."""
    return np.concatenate([part[0][..., None], part[1]], axis=-1)


@dataclass(frozen=True, eq=False)
class LineWhitener(Whitener):
    """Rows are real and imaginary parts of the whole record's Fourier lines, divided by the noise's square root.

    samples    n of the whole record, and `repeats` of one period in it
    motion     indices of the lines that the motion lives on, in multiples of `repeats`; `between` the others
    root       inverse Cholesky factors of the spectral matrix at the motion's lines, then at those between
    A line k of unit white noise has E|sum x exp|² = n; its two parts share that, line 0 has only one.
    """

    samples: int
    repeats: int
    motion: NDArray[np.intp]
    between: NDArray[np.intp]
    root: Lines

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Two rows per line and channel."""
        return 2 * int(self.root.shape[1]) * (len(self.motion) + len(self.between))

    @property
    def steady_rows(self) -> int:  # type: ignore[override]
        """The rows of the motion's lines."""
        return 2 * int(self.root.shape[1]) * len(self.motion)

    def series(self, values: Array) -> Array:
        """Rows of a series over the whole record, those of the motion's lines first."""
        rows = np.empty((self.rows, *values.shape[2:]))
        for own, part in _parts(values, rows):
            lines = rfft(part, axis=0)
            own[: self.steady_rows] = self.at_motion(lines[self.motion])
            if len(self.between):
                own[self.steady_rows :] = self.beside(lines)
        return rows

    def steady(self, values: Array) -> Array:
        """Rows of one repeat of a periodic series, at the motion's lines."""
        return self.at_motion(rfft(values, axis=0)[self.motion // self.repeats] * self.repeats)

    def rest(self, values: Array) -> Array:
        """Rows of a series over the whole record at the lines between the motion's."""
        rows = np.empty((self.rows - self.steady_rows, *values.shape[2:]))
        for own, part in _parts(values, rows):
            own[...] = self.beside(rfft(part, axis=0))
        return rows

    def at_motion(self, lines: Lines) -> Array:
        """Rows of the motion's own lines."""
        return self._rows(lines, self.motion, self.root[: len(self.motion)])

    def beside(self, lines: Lines) -> Array:
        """Rows of the lines between, given all lines."""
        return self._rows(lines[self.between], self.between, self.root[len(self.motion) :])

    def _rows(self, lines: Lines, index: NDArray[np.intp], root: Lines) -> Array:
        shape = lines.shape
        flat = np.matmul(root, lines.reshape(shape[0], shape[1], -1))
        single = (index == 0) | (2 * index == self.samples)
        scale = np.sqrt((2.0 - single) / self.samples)
        flat *= scale[:, None, None]
        return np.concatenate([flat.real, flat.imag], axis=1).reshape(2 * shape[0] * shape[1], *shape[2:])


def _parts(values: Array, rows: Array) -> Iterator[tuple[Array, Array]]:
    """Series (n, p, ...) a few columns at a time, (n, p, c), with the rows (r, c) that they become."""
    flat, into = values.reshape(*values.shape[:2], -1), rows.reshape(len(rows), -1)
    at_once = max(1, MOST_NUMBERS // max(1, values.shape[0] * values.shape[1]))
    for first in range(0, flat.shape[2], at_once):
        yield into[:, first : first + at_once], flat[:, :, first : first + at_once]


@dataclass(frozen=True, eq=False)
class RegressionWhitener(Whitener):
    """Rows are the innovations of an autoregression, for a single run; order 0 for poses at rest.

    block         samples averaged into one before anything else; a tool moves slower than a sensor samples
    coefficients  (order, p) of each channel: noise[t] = sum_i a_i noise[t-i] + innovation
    root          (p, p) inverse Cholesky factor of the innovations' covariance
    events        ranges of blocks with a noise of their own, white, with the inverse factor `event_root`; the `order`
                  samples after each, which would be predicted from it, count nothing
    """

    samples: int
    block: int
    coefficients: Array
    root: Array
    events: tuple[tuple[int, int], ...] = ()
    event_root: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def rows(self) -> int:  # type: ignore[override]
        """One row per block and channel after the first `order` blocks."""
        return (self.samples // self.block - len(self.coefficients)) * len(self.root)

    @property
    def steady_rows(self) -> int:  # type: ignore[override]
        """All rows: a single run has no lines between."""
        return self.rows

    def series(self, values: Array) -> Array:
        """Rows of a series over the whole record."""
        order = len(self.coefficients)
        flat = block_means(values.reshape(*values.shape[:2], -1), self.block)
        innovation = flat[order:].copy()
        for lag, past in enumerate(self.coefficients, start=1):
            innovation -= past[:, None] * flat[order - lag : len(flat) - lag]
        white = np.matmul(self.root, innovation)
        for start, end in self.events if self.event_root is not None else ():
            first, last = max(start, order), max(end, order)
            white[first - order : last - order] = np.matmul(self.event_root, flat[first:last])
            white[last - order : end] = 0.0
        return np.asarray(white.reshape(-1, *values.shape[2:]))

    def steady(self, values: Array) -> Array:
        """The same as `series`: one repeat is the whole run."""
        return self.series(values)


def block_means(values: Array, block: int) -> Array:
    """Means (n // block, ...) of successive blocks of samples; what does not fill a block at the end is left out."""
    count = len(values) // block
    return np.asarray(values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1))


def inverse_root(covariance: Array | Lines) -> Array | Lines:
    """Inverse Cholesky factor W of a covariance, W C W^H = 1."""
    factor = np.linalg.cholesky(covariance)
    return np.asarray(solve_triangular(factor, np.eye(len(factor)), lower=True))
