"""Whitening: linear maps from series of readings to rows that are independent, of unit variance, under the noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy  # loads scipy.fft with its first use
from numpy.typing import NDArray

from estimation.model_response import ModelResponse
from modeling.noise import FourierLines, NoiseModel, block_means, whitened_by_channel

Array = NDArray[np.float64]

COLUMNS_AT_ONCE = 16
"""Columns that are projected together, so that the leakage directions are read once for all of them."""
TRANSFORM_BATCH = 100_000
"""Numbers per batch of Fourier transforms: with their lines they fit into a core's cache."""


class Whitener(ABC):
    """A linear map from a series (n, p) of readings to real rows of unit variance under the noise.

    The first `periodic_rows` rows carry the part that is periodic with the motion; what is not periodic reaches all.
    A series may be given by its means over blocks of `block` samples.
    """

    rows: int
    periodic_rows: int
    block: int = 1

    @abstractmethod
    def series(self, values: Array) -> Array:
        """Rows (rows, ...) of a series over the whole record (n, p, ...)."""

    @abstractmethod
    def steady_state(self, values: Array) -> Array:
        """Rows (periodic_rows, ...) of a periodic series, given one repeat (n / repeats, p, ...)."""

    def non_excited(self, values: Array) -> Array:
        """Rows (rows - periodic_rows, ...) of a series over the whole record that are zero for periodic series."""
        return self.series(values)[self.periodic_rows :]

    def nonzero_rows(self, response: ModelResponse) -> Array:
        """Rows (r, 1 + k) of a predicted value and of its derivative, without the trailing rows that are zero.

        r is `periodic_rows` for a response that is periodic with the motion, else all rows. Of the mean motion.
        """
        periodic = self.steady_state(_joined(response.periodic))
        if response.whole is None:
            return periodic
        transient = self.series(_joined(response.whole))
        if response.columns is None or len(response.columns) == periodic.shape[-1] - 1:
            rows = transient
        else:
            rows = np.zeros((self.rows, *periodic.shape[1:]), order="F")
            rows[..., [0, *(1 + i for i in response.columns)]] = transient
        rows[: self.periodic_rows] += periodic
        return rows

    def response(self, response: ModelResponse) -> tuple[Array, Array]:
        """Rows of a predicted value, (rows,), and of its derivative, (rows, k)."""
        reached = self.nonzero_rows(response)
        rows = np.zeros((self.rows, *reached.shape[1:]))
        rows[: len(reached)] = reached
        if response.own_motion is not None:
            rows[..., 0] += self.series(response.own_motion)
        return rows[..., 0], rows[..., 1:]


def _joined(tangent: tuple[Array, Array]) -> Array:
    """A value (n, p, ...) and its derivative (n, p, ..., k) as one series (n, p, ..., 1 + k).

    No copy where both are views of such a series.
    """
    value, derivative = tangent
    whole, shape = value.base, (*value.shape, 1 + derivative.shape[-1])
    is_joint = whole is not None and whole is derivative.base and whole.shape == shape
    if whole is not None and is_joint and _same_view(value, whole[..., 0]) and _same_view(derivative, whole[..., 1:]):
        return whole
    joined = np.empty((*value.shape, 1 + derivative.shape[-1]), order="F")
    joined[..., 0], joined[..., 1:] = value, derivative
    return joined


def _same_view(one: Array, other: Array) -> bool:
    """Whether two views of an array cover the same elements."""
    return one.strides == other.strides and one.__array_interface__["data"] == other.__array_interface__["data"]


@dataclass(frozen=True, eq=False)
class FourierLineWhitener(Whitener):
    """Rows are real and imaginary parts of the whole record's Fourier lines, over the root of the noise spectrum.

    samples    n of the whole record, and `repeats` of one period in it
    excited_lines, non_excited_lines  indices; the excited ones are multiples of `repeats`
    root       inverse Cholesky factors of the spectral matrix at the excited, then at the non-excited lines
    excited_leakage, non_excited_leakage  orthonormal directions (k, rows) that are projected out of the rows of the
               excited and of the non-excited lines (`without_leakage`)
    A line k of unit white noise has E|sum x exp|² = n; its real and imaginary parts share that, line 0 has only one.
    """

    samples: int
    repeats: int
    excited_lines: NDArray[np.intp]
    non_excited_lines: NDArray[np.intp]
    root: FourierLines
    excited_leakage: Array | None = None
    non_excited_leakage: Array | None = None

    @property
    def rows(self) -> int:  # type: ignore[override]
        """Two rows per line and channel."""
        return 2 * int(self.root.shape[1]) * (len(self.excited_lines) + len(self.non_excited_lines))

    @property
    def periodic_rows(self) -> int:  # type: ignore[override]
        """The rows of the excited lines."""
        return 2 * int(self.root.shape[1]) * len(self.excited_lines)

    def series(self, values: Array) -> Array:
        """Rows of a series over the whole record, those of the excited lines first."""
        columns = _ColumnBatches.of(values, self.rows)
        excited, non_excited = np.split(columns.rows, [self.periodic_rows], axis=1)
        for series, selection in columns.parts():
            lines = scipy.fft.rfft(series)
            self._whiten(lines[:, :, self.excited_lines], excited[selection], self._roots[0])
            if len(self.non_excited_lines):
                self._whiten(lines[:, :, self.non_excited_lines], non_excited[selection], self._roots[1])
        _project_out(self.excited_leakage, excited)
        _project_out(self.non_excited_leakage, non_excited)
        return columns.result

    def steady_state(self, values: Array) -> Array:
        """Rows of a periodic series, given one repeat, at the excited lines."""
        columns, excited = _ColumnBatches.of(values, self.periodic_rows), self.excited_lines // self.repeats
        for series, selection in columns.parts():
            self._whiten(scipy.fft.rfft(series)[:, :, excited] * self.repeats, columns.rows[selection], self._roots[0])
        _project_out(self.excited_leakage, columns.rows)
        return columns.result

    def non_excited(self, values: Array) -> Array:
        """Rows of a series over the whole record at the non-excited lines."""
        columns = _ColumnBatches.of(values, self.rows - self.periodic_rows)
        for series, selection in columns.parts():
            self._whiten(scipy.fft.rfft(series)[:, :, self.non_excited_lines], columns.rows[selection], self._roots[1])
        _project_out(self.non_excited_leakage, columns.rows)
        return columns.result

    def with_filter(self, transfer: Callable[[Array], FourierLines], dt: float) -> Self:
        """The whitener of series filtered by a transfer function of angular frequencies (rad/s).

        `dt` in s; the series are periodic, so that the filter is a factor at each line, real at half the sampling
        rate.
        """
        index = np.concatenate([self.excited_lines, self.non_excited_lines])
        gain = transfer(2 * np.pi * index / (self.samples * dt))
        gain = np.where(2 * index == self.samples, gain.real, gain)
        return replace(self, root=self.root * gain[:, None, None])

    @cached_property
    def _roots(self) -> tuple[FourierLines, FourierLines]:
        """The roots (p, p, lines) of excited and non-excited lines, scaled so that each row has unit variance."""
        index = np.concatenate([self.excited_lines, self.non_excited_lines])
        single = (index == 0) | (2 * index == self.samples)
        scaled = np.ascontiguousarray(self.root.transpose(1, 2, 0) * np.sqrt((2.0 - single) / self.samples))
        return scaled[:, :, : len(self.excited_lines)], scaled[:, :, len(self.excited_lines) :]

    @staticmethod
    def _whiten(lines: FourierLines, rows: Array, root: FourierLines) -> None:
        """Real, then imaginary parts of root times lines."""
        into = rows.reshape(len(rows), root.shape[2], 2, len(root))
        for channel, white in whitened_by_channel(root, lines):
            into[:, :, 0, channel], into[:, :, 1, channel] = white.real, white.imag


def _project_out(directions: Array | None, rows: Array) -> None:
    """Project directions (k, r) out of rows (c, r), in place, and scale them to their former expected variance."""
    if directions is None or not (rows.size and directions.size):
        return
    scale = np.sqrt(directions.shape[1] / (directions.shape[1] - len(directions)))
    for first in range(0, len(rows), COLUMNS_AT_ONCE):
        batch = rows[first : first + COLUMNS_AT_ONCE]
        batch -= (batch @ directions.T) @ directions
        batch *= scale


@dataclass(frozen=True, eq=False)
class _ColumnBatches:
    """Series (c, p, n) in batches of a few columns, and the rows (c, r) that they become.

    No copy for series (n, p, ...) in Fortran order.
    """

    series: Array
    rows: Array
    shape: tuple[int, ...]

    @classmethod
    def of(cls, values: Array, rows: int) -> _ColumnBatches:
        """Of values (n, p, ...) that become this many rows."""
        series = values.T.reshape(-1, *values.shape[1::-1])
        return cls(series, np.empty((len(series), rows)), values.shape[:1:-1])

    def parts(self) -> Iterator[tuple[Array, slice]]:
        """Batches of columns (c, p, n), each with its slice."""
        batch = max(1, TRANSFORM_BATCH // max(1, self.series[0].size)) if len(self.series) else 1
        for first in range(0, len(self.series), batch):
            selection = slice(first, first + batch)
            yield self.series[selection], selection

    @property
    def result(self) -> Array:
        """The rows (r, ...)."""
        return (
            self.rows.reshape(*self.shape, -1).T
            if self.rows.size
            else np.zeros((self.rows.shape[1], *self.shape[::-1]))
        )


@dataclass(frozen=True, eq=False)
class AutoregressiveWhitener(Whitener):
    """Rows are the innovations of autoregressive noise, for a single run; order 0 for static poses.

    noise   of the record, of averages over its blocks: a tool's motion is slow against the sample rate
    weights (blocks,), factors of the rows of each block: smaller where its noise is larger
    events  ranges of blocks with a noise of their own, `event_noise`, taken as white; the `order` samples after each,
            which would be predicted from it, get weight zero
    left_out  numbers of channels whose rows have weight zero
    """

    samples: int
    noise: NoiseModel
    events: tuple[tuple[int, int], ...] = ()
    event_noise: NoiseModel | None = None
    weights: Array | None = None
    left_out: tuple[int, ...] = ()

    @property
    def block(self) -> int:  # type: ignore[override]
        """Samples of a block."""
        return self.noise.block

    @property
    def rows(self) -> int:  # type: ignore[override]
        """One row per block and channel after the first `order` blocks."""
        return (self.samples // self.block - self.noise.order) * len(self.noise.covariance)

    @property
    def periodic_rows(self) -> int:  # type: ignore[override]
        """All rows: a single run has no non-excited lines."""
        return self.rows

    def series(self, values: Array) -> Array:
        """Rows of a series over the whole record, or of its means."""
        means = block_means(values, self.block) if len(values) == self.samples else values
        columns = _ColumnBatches.of(means, self.rows)
        for series, selection in columns.parts():
            self._whiten(series, columns.rows[selection].reshape(len(series), -1, series.shape[1]))
        return columns.result

    def _whiten(self, means: Array, rows: Array) -> None:
        """Write the whitened innovations of block means (c, p, blocks) into rows (c, blocks - order, p)."""
        order = self.noise.order
        np.matmul(self.noise.innovations(means).swapaxes(1, 2), self.noise.root.T, out=rows)
        if self.event_noise is not None:
            self._whiten_events(means, rows, self.event_noise)
        if self.weights is not None:
            rows *= self.weights[order:, None]
        if self.left_out:
            rows[:, :, list(self.left_out)] = 0.0

    def _whiten_events(self, means: Array, rows: Array, noise: NoiseModel) -> None:
        order = self.noise.order
        for start, end in self.events:
            first, last = max(start, order), max(end, order)
            rows[:, first - order : last - order] = means[:, :, first:last].swapaxes(1, 2) @ noise.root.T
            rows[:, last - order : end] = 0.0

    def steady_state(self, values: Array) -> Array:
        """The same as `series`: one repeat is the whole run."""
        return self.series(values)

    def of_channel(self, channel: int) -> AutoregressiveWhitener:
        """The whitener of one channel, for a series that is zero in the others."""
        in_events = None if self.event_noise is None else self.event_noise.of_channel(channel)
        left_out = (0,) if channel in self.left_out else ()
        return replace(self, noise=self.noise.of_channel(channel), event_noise=in_events, left_out=left_out)

    def without(self, channels: Sequence[int]) -> AutoregressiveWhitener:
        """The whitener with weight zero for channels, which tell nothing of the noise of others then."""
        alone = np.isin(np.arange(len(self.noise.covariance)), channels)
        covariance = np.where((alone[:, None] | alone) & ~np.eye(len(alone), dtype=bool), 0.0, self.noise.covariance)
        return replace(self, noise=replace(self.noise, covariance=covariance), left_out=tuple(channels))


@dataclass(frozen=True, eq=False)
class PoseWhitener(Whitener):
    """Rows are static poses, of which neighbouring ones share slow noise, by a map of each channel to independent ones.

    roots  (p, m, m), inverse Cholesky factors of the covariance of m poses
    """

    roots: Array

    @property
    def rows(self) -> int:  # type: ignore[override]
        """One row per pose and channel."""
        return int(self.roots.shape[0] * self.roots.shape[1])

    @property
    def periodic_rows(self) -> int:  # type: ignore[override]
        """All rows."""
        return self.rows

    def series(self, values: Array) -> Array:
        """Rows of a series over all poses."""
        white = np.einsum("pij,jp...->ip...", self.roots, values)
        return np.asarray(white.reshape(self.rows, *values.shape[2:]))

    def steady_state(self, values: Array) -> Array:
        """The same as `series`."""
        return self.series(values)
