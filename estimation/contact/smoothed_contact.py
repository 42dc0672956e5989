"""Contact wrench smoothed at a stated lag, as well as the noise of the recording allows.

A row of the result is the contact at that row's time, from the readings until `lag` later: what a controller would have
with that lag. Of all weights over a window of 2 h + 1 samples, h dt the lag, that reproduce a constant and a straight
line, those leave the least noise that the noise's autocovariance gives least variance to (best linear unbiased). White
noise is averaged, a vibration is cancelled, and a contact that begins is through after the window, not later.

At the ends of a run there are not so many readings: a row takes the widest window that fits there, of half the lag, a
quarter and so on, the last row its own reading alone, and has that window's noise.

The noise is that of the samples without contact. Where the recording has the accelerations of an inertial unit on the
tool, what shakes tool and sensor is in both: samples of these enter with weights of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve, toeplitz
from scipy.ndimage import minimum_filter1d
from scipy.signal import correlate, oaconvolve

from modeling.errors import InputError, quoted

Array = NDArray[np.float64]
SampleMask = NDArray[np.bool_]

INERTIAL = ("imu_ax", "imu_ay", "imu_az")
"""Columns with an inertial unit's accelerations; unit, axes and place do not matter, being in the weights."""
FEWEST_WINDOWS = 10
"""Windows without contact in each half of a recording: fewer do not show the noise that is to be cancelled."""
MOST_WEIGHTS = 501
"""Weights of one series: with three accelerations 2004 unknowns, half a second a component. Longer lags are those of a
slow signal, which has too many samples."""


LEAST_GAIN = 0.05
"""Share of the variance by which an inertial unit has to lower the noise in both halves of a recording to enter: of one
that feels something else, the variances differ by less than that, either way."""
CONSTANT = 1e-9
"""Range of a unit's accelerations over their size, below which they are rounding."""


class _Noise(NamedTuple):
    """What weights are computed from: covariances of delayed samples of one half of a recording.

    lagged    (s, s, 2 m - 1): E[a[t] b[t + k]] for k = -(m - 1) .. m - 1, of a window of m samples
    samples   number of samples that they rest on
    """

    lagged: Array
    samples: int

    @classmethod
    def of(cls, runs: Sequence[Array], masks: Sequence[SampleMask], window: int) -> _Noise:
        """Of the free samples of runs (n, s) one after the other; a Gram matrix of shifted series, so never negative.

        Samples with contact count as zero, and so does what is before and after a run.
        """
        series = runs[0].shape[1]
        lagged = np.zeros((series, series, 2 * window - 1))
        for run, mask in zip(runs, masks, strict=True):
            free = run * mask[:, None]
            middle = len(free) - 1
            for a in range(series):
                for b in range(series):
                    products = correlate(free[:, b], free[:, a], "full", "fft")
                    reach = min(window - 1, middle)
                    lagged[a, b, window - 1 - reach : window + reach] += products[middle - reach : middle + reach + 1]
        samples = int(sum(mask.sum() for mask in masks))
        return cls(lagged / max(samples, 1), samples)

    def weights(self, series: Sequence[int], window: int) -> Array:
        """(s, m): weights of the samples t - h .. t + h of these series, of which the first is to be kept.

        Least variance under the conditions that the first's sum to one and have no first moment; one sample is
        itself. Few samples make a covariance of so many unknowns too small in some direction: it is shrunk to that of
        white noise by the share of unknowns in samples.
        """
        if window == 1:
            return np.eye(len(series), 1)
        index = list(series)
        covariance = np.block([[self._block(a, b, window) for b in index] for a in index])
        share = min(1.0, len(covariance) / max(self.samples, 1))
        power = np.repeat([self.lagged[a, a, self._now] for a in index], window)
        covariance[np.diag_indices_from(covariance)] += share * np.maximum(power, np.finfo(float).tiny)
        place = np.linspace(-1.0, 1.0, window)
        kept = np.zeros((len(covariance), 2))
        kept[:window] = np.column_stack([np.ones(window), place])
        solved = solve(covariance, kept, assume_a="pos")
        found = solved @ np.linalg.solve(kept.T @ solved, np.array([1.0, 0.0]))
        return np.asarray(found.reshape(len(index), window))

    @property
    def _now(self) -> int:
        """The place of k = 0."""
        return int(self.lagged.shape[2] // 2)

    def _block(self, a: int, b: int, window: int) -> Array:
        """(m, m): E[a[t + i] b[t + j]], i and j from one end of the window to the other."""
        later = self.lagged[a, b, self._now : self._now + window]
        earlier = self.lagged[a, b, self._now - window + 1 : self._now + 1][::-1]
        return np.asarray(toeplitz(earlier, later))


@dataclass(frozen=True, eq=False)
class _Windows:
    """The series of a recording in runs, each (n, p + u): p components of the contact, u accelerations."""

    runs: list[Array]
    free: list[SampleMask]
    components: int
    half: int

    @property
    def window(self) -> int:
        """Samples of a window."""
        return 2 * self.half + 1

    @property
    def inertial(self) -> tuple[int, ...]:
        """The numbers of the accelerations."""
        return tuple(range(self.components, self.runs[0].shape[1]))

    def halves(self) -> tuple[list[SampleMask], list[SampleMask]]:
        """The free samples of the first and of the second half of the recording."""
        count = sum(map(len, self.free))
        whole, first = np.concatenate(self.free), np.arange(count) < count // 2
        ends = np.cumsum([len(run) for run in self.runs])[:-1]
        return np.split(whole & first, ends), np.split(whole & ~first, ends)

    def whole_windows(self, masks: Sequence[SampleMask]) -> list[SampleMask]:
        """The samples whose whole window is in the mask."""
        return [minimum_filter1d(mask.astype(np.uint8), self.window, mode="constant") > 0 for mask in masks]

    @property
    def halves_of_windows(self) -> tuple[int, ...]:
        """h, and those of the windows at the ends, down to 0."""
        return *(self.half >> power for power in range(self.half.bit_length())), 0

    def smoothed(self, series: Sequence[int], weights: Array) -> list[Array]:
        """(n - 2 h,) of each run, the rows whose window of these weights (s, 2 h + 1) is in the run."""
        parts = []
        for run in self.runs:
            # Weights are by place in the window; a convolution takes them from the last sample to the first.
            pairs = zip(run[:, list(series)].T, weights, strict=True)
            parts.append(np.sum([oaconvolve(one, each[::-1], "valid") for one, each in pairs], axis=0))
        return parts


class SmoothedSeries(NamedTuple):
    """Components (n, p) at a lag (s), the covariance (n, p, p) of their noise, and which of them the unit entered."""

    wrench: Array
    noise: Array
    lag: float
    with_unit: tuple[int, ...]


def smoothed_series(
    wrench: Array, accelerations: Array, free: SampleMask, *, dt: float | None, runs: int, lag: float, name: str
) -> SmoothedSeries:
    """Contact wrenches (n, p) smoothed at a lag, s; `free` (n,) are samples without contact, `dt` s between samples.

    Of `runs` runs of equal length, none going on in the next. `accelerations` (n, u) are an inertial unit's, less what
    the free tool's motion makes of them. The covariance is measured, and whether the unit helps is decided, where the
    weights were not computed: those of each half of the recording are tried on the other. The result's are computed
    from both. Raises InputError, with the recording's name, for static poses, a lag below one sample or above a quarter
    of a run, and too few samples without contact.
    """
    windows = _windows(wrench, accelerations, free, dt=dt, runs=runs, lag=lag, name=name)
    first, second = windows.halves()
    halves = [
        (_Noise.of(windows.runs, masks, windows.window), windows.whole_windows(others))
        for masks, others in ((first, second), (second, first))
    ]
    whole = _Noise.of(windows.runs, windows.free, windows.window)
    chosen: list[tuple[int, ...]] = [(component,) for component in range(wrench.shape[1])]
    if windows.inertial:
        chosen = [_quieter(windows, halves, (*alone, *windows.inertial), alone) for alone in chosen]
    size = wrench.shape[1]
    values = [np.empty((len(run), size)) for run in windows.runs]
    covariances = [np.empty((len(run), size, size)) for run in windows.runs]
    for half in sorted(windows.halves_of_windows):  # a wider window replaces the rows where it fits
        held_out = [np.concatenate(_tried(windows, halves, series, half)) for series in chosen]
        columns = [windows.smoothed(series, whole.weights(series, 2 * half + 1)) for series in chosen]
        for number, run in enumerate(values):
            rows = slice(half, len(run) - half)
            run[rows] = np.column_stack([column[number] for column in columns])
            covariances[number][rows] = np.cov(held_out)
    with_unit = tuple(number for number, series in enumerate(chosen) if len(series) > 1)
    lasting = windows.half * float(dt or 0.0)
    return SmoothedSeries(np.concatenate(values), np.concatenate(covariances), lasting, with_unit)


def _quieter(
    windows: _Windows,
    halves: Sequence[tuple[_Noise, list[SampleMask]]],
    with_unit: tuple[int, ...],
    alone: tuple[int, ...],
) -> tuple[int, ...]:
    """The series with the unit where it lowers the noise in both halves of the recording, else those without."""
    pairs = zip(*(_tried(windows, halves, series, windows.half) for series in (with_unit, alone)), strict=True)
    return with_unit if all(helped.var() < (1 - LEAST_GAIN) * left.var() for helped, left in pairs) else alone


def _tried(
    windows: _Windows, halves: Sequence[tuple[_Noise, list[SampleMask]]], series: Sequence[int], half: int
) -> list[Array]:
    """The free samples of each half of the recording, smoothed over 2 h + 1 by the weights of the other, (k,) each."""
    parts = []
    for noise, kept in halves:
        runs = windows.smoothed(series, noise.weights(series, 2 * half + 1))
        inner = [mask[half : len(mask) - half] for mask in kept]
        parts.append(np.concatenate([run[mask] for run, mask in zip(runs, inner, strict=True)]))
    return parts


def _windows(
    wrench: Array, accelerations: Array, free: SampleMask, *, dt: float | None, runs: int, lag: float, name: str
) -> _Windows:
    where = f"{name}, lag"
    if not (isinstance(cast("object", lag), int | float | np.number) and 0 < lag < np.inf):
        raise InputError(what=f"{quoted(lag)} is no lag", where=where, remedy="give a time above zero, in s")
    if dt is None:
        raise InputError(what="static poses have no lag", where=where, remedy="leave out the lag")
    half = int(np.floor(lag / dt * (1 + 1e-9)))  # 1e-9: rounding of the ratio
    longest = min(len(wrench) // runs // 4, MOST_WEIGHTS // 2)
    if not 1 <= half <= longest:
        what = f"a lag of {lag * 1e3:g} ms is {half} samples"
        remedy = f"give one of {dt * 1e3:.3g} to {longest * dt * 1e3:.3g} ms"
        raise InputError(what=what, where=where, remedy=remedy)
    series = np.column_stack([wrench, accelerations])
    windows = _Windows(np.split(series, runs), np.split(free, runs), wrench.shape[1], half)
    kept = [sum(int(mask.sum()) for mask in windows.whole_windows(masks)) for masks in windows.halves()]
    least = FEWEST_WINDOWS * windows.window
    if min(kept) < least:
        what = (
            f"{min(kept)} samples of one half of the recording have no contact within {lag * 1e3:g} ms, and its noise"
            f" is not known from fewer than {least}"
        )
        raise InputError(what=what, where=where, remedy="give a shorter lag, or a recording with longer free motion")
    return windows


def inertial_accelerations(signals: Mapping[str, Array], load: Array) -> Array:
    """An inertial unit's accelerations (n, u) less what follows from the tool's load (n, p), its weight and motion.

    Those of `INERTIAL` that were recorded, are finite and vary.
    """
    known = np.column_stack([np.ones(len(load)), load])
    left = [np.zeros((len(load), 0))]
    for series in (signals[name] for name in INERTIAL if name in signals):
        if np.isfinite(series).all() and np.ptp(series) > CONSTANT * np.abs(series).max():
            left.append((series - known @ np.linalg.lstsq(known, series, rcond=None)[0])[:, None])
    return np.hstack(left)
