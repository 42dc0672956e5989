"""Whitening: from series of readings to rows of unit variance, independent under the noise alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import solve_triangular

from estimation.response import Response

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]
Series = TypeVar("Series", Array, Lines)

MOST_NUMBERS = 100_000
"""Numbers that are transformed together: with their lines they stay in a core's cache."""


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
            rows = np.zeros((self.rows, *steady.shape[1:]), order="F")
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
    """A value (n, p, ...) and its derivative (n, p, ..., k) as one series (n, p, ..., 1 + k), transformed at once.

    Nothing is copied where both are views of such a series.
    """
    value, derivative = part
    whole, shape = value.base, (*value.shape, 1 + derivative.shape[-1])
    joins = whole is not None and whole is derivative.base and whole.shape == shape
    if whole is not None and joins and _same(value, whole[..., 0]) and _same(derivative, whole[..., 1:]):
        return whole
    joined = np.empty((*value.shape, 1 + derivative.shape[-1]), order="F")
    joined[..., 0], joined[..., 1:] = value, derivative
    return joined


def _same(one: Array, other: Array) -> bool:
    """Whether two views of an array are the same part of it."""
    return one.strides == other.strides and one.__array_interface__["data"] == other.__array_interface__["data"]


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
        columns = _Columns.of(values, self.rows)
        steady, rest = np.split(columns.rows, [self.steady_rows], axis=1)
        for part, own in columns.parts():
            lines = rfft(part)
            self._at_motion(lines[:, :, self.motion], steady[own])
            if len(self.between):
                self._between(lines[:, :, self.between], rest[own])
        self.finish(steady, rest)
        return columns.found

    def steady(self, values: Array) -> Array:
        """Rows of one repeat of a periodic series, at the motion's lines."""
        columns, excited = _Columns.of(values, self.steady_rows), self.motion // self.repeats
        for part, own in columns.parts():
            self._at_motion(rfft(part)[:, :, excited] * self.repeats, columns.rows[own])
        self.finish(columns.rows, columns.rows[:, :0])
        return columns.found

    def rest(self, values: Array) -> Array:
        """Rows of a series over the whole record at the lines between the motion's."""
        columns = _Columns.of(values, self.rows - self.steady_rows)
        for part, own in columns.parts():
            self._between(rfft(part)[:, :, self.between], columns.rows[own])
        self.finish(columns.rows[:, :0], columns.rows)
        return columns.found

    def behind(self, transfer: Callable[[Array], Lines], dt: float) -> Self:
        """What whitens series that pass a transfer function, of angular frequencies (rad/s), before they are read.

        `dt` in s; the series repeat themselves without pause, so that it is a factor of each line, and real on the one
        at half the sampling rate.
        """
        index = np.concatenate([self.motion, self.between])
        gain = transfer(2 * np.pi * index / (self.samples * dt))
        gain = np.where(2 * index == self.samples, gain.real, gain)
        return replace(self, root=self.root * gain[:, None, None])

    def finish(self, steady: Array, rest: Array) -> None:
        """What is done to rows (c, steady_rows) and (c, rows - steady_rows), in place, before they are given away."""

    def _at_motion(self, lines: Lines, rows: Array) -> None:
        """Put the rows (c, steady_rows) of the motion's own lines (c, p, len(motion)) where `rows` are."""
        self._whiten(lines, rows, self._scaled[:, :, : len(self.motion)])

    def _between(self, lines: Lines, rows: Array) -> None:
        """Put the rows (c, rows - steady_rows) of the lines between (c, p, len(between)) where `rows` are."""
        self._whiten(lines, rows, self._scaled[:, :, len(self.motion) :])

    @cached_property
    def _scaled(self) -> Lines:
        """The root (p, p, lines), so scaled that each row has unit variance."""
        index = np.concatenate([self.motion, self.between])
        single = (index == 0) | (2 * index == self.samples)
        return np.ascontiguousarray(self.root.transpose(1, 2, 0) * np.sqrt((2.0 - single) / self.samples))

    @staticmethod
    def _whiten(lines: Lines, rows: Array, root: Lines) -> None:
        """Real, then imaginary parts of root times lines."""
        into = rows.reshape(len(rows), root.shape[2], 2, len(root))
        for channel, mixed in _mixed(root, lines):
            into[:, :, 0, channel], into[:, :, 1, channel] = mixed.real, mixed.imag


@dataclass(frozen=True, eq=False)
class _Columns:
    """Series (c, p, n) taken a few columns at a time, and the rows (c, r) that they become, column after column.

    Where series (n, p, ...) are kept with their samples next to each other (Fortran's order), nothing is copied.
    """

    series: Array
    rows: Array
    shape: tuple[int, ...]

    @classmethod
    def of(cls, values: Array, rows: int) -> _Columns:
        """Of values (n, p, ...) that become so many rows."""
        turned = values.T.reshape(-1, *values.shape[1::-1])
        return cls(turned, np.empty((len(turned), rows)), values.shape[:1:-1])

    def parts(self) -> Iterator[tuple[Array, slice]]:
        """Columns (c, p, n), with which they are."""
        at_once = max(1, MOST_NUMBERS // max(1, self.series[0].size)) if len(self.series) else 1
        for first in range(0, len(self.series), at_once):
            part = slice(first, first + at_once)
            yield self.series[part], part

    @property
    def found(self) -> Array:
        """The rows (r, ...)."""
        return (
            self.rows.reshape(*self.shape, -1).T
            if self.rows.size
            else np.zeros((self.rows.shape[1], *self.shape[::-1]))
        )


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
        columns = _Columns.of(block_means(values, self.block), self.rows)
        for part, own in columns.parts():
            self._whiten(part, columns.rows[own].reshape(len(part), -1, len(self.root)))
        return columns.found

    def _whiten(self, means: Array, rows: Array) -> None:
        """Put the innovations of block means (c, p, blocks), whitened, into rows (c, blocks - order, p)."""
        order, blocks = len(self.coefficients), means.shape[2]
        innovation = means[:, :, order:].copy()
        for lag, past in enumerate(self.coefficients, start=1):
            innovation -= past[:, None] * means[:, :, order - lag : blocks - lag]
        for channel, mixed in _mixed(self.root, innovation):
            rows[:, :, channel] = mixed
        for start, end in self.events:
            first, last = max(start, order), max(end, order)
            for channel, mixed in _mixed(self.event_root, means[:, :, first:last]):
                rows[:, first - order : last - order, channel] = mixed
            rows[:, last - order : end] = 0.0

    def steady(self, values: Array) -> Array:
        """The same as `series`: one repeat is the whole run."""
        return self.series(values)

    def alone(self, channel: int) -> RegressionWhitener:
        """What gives one channel's rows of a series that has nothing in the others."""
        own = slice(channel, channel + 1)
        root, event_root = self.root[own, own], self.event_root[own, own]
        return replace(self, coefficients=self.coefficients[:, own], root=root, event_root=event_root)


def _mixed(root: Series, series: Series) -> Iterator[tuple[int, Series]]:
    """Channels with a root (p, p, ...), which is triangular, times series (c, p, n) in each, (c, n)."""
    for channel in range(len(root)):
        mixed = root[channel, 0] * series[:, 0]
        for other in range(1, channel + 1):
            mixed += root[channel, other] * series[:, other]
        yield channel, mixed


def block_means(values: Array, block: int) -> Array:
    """Means (n // block, ...) of successive blocks of samples; what does not fill a block at the end is left out."""
    if block == 1:
        return values
    count = len(values) // block
    parts = values[: count * block].T.reshape(*values.shape[:0:-1], count, block)
    return np.asarray((parts @ np.full(block, 1 / block)).T)


def inverse_root(covariance: Array | Lines) -> Array | Lines:
    """Inverse Cholesky factor W of a covariance, W C W^H = 1."""
    factor = np.linalg.cholesky(covariance)
    return np.asarray(solve_triangular(factor, np.eye(len(factor)), lower=True))
