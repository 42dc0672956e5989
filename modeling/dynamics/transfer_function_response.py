"""Response of a transfer function to a whole record, by Fourier transform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # loads scipy.fft with its first use
from numpy.typing import NDArray

from modeling.dynamics.motion_record import MotionRecord

Array = NDArray[np.float64]

FILTER_BATCH = 50_000
"""Numbers filtered at once: with their Fourier lines they fit in a core's cache."""


def through_transfer_function(record: MotionRecord, series: Array, slope: int | None = None) -> Array:
    """A series (samples, ...) filtered by H(s), or by H's derivative in its parameter number `slope`.

    A motion that repeats without pause is in its periodic steady state. A single run is extended on both sides by
    its point reflections before it is transformed. In static poses H(0) = 1.
    """
    if not series.size:
        return series
    if record.dt is None:
        return series if slope is None else np.zeros_like(series)
    runs = [_filtered_run(record, run, slope) for run in record.runs(series)]
    return runs[0] if len(runs) == 1 else np.concatenate(runs)


def _filtered_run(record: MotionRecord, series: Array, slope: int | None) -> Array:
    assert record.dt is not None
    before, after = (0, 0) if record.clock.periodic else _extension(len(series))
    length = before + len(series) + after
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(length, record.dt), dtype=np.float64)
    gain, slopes = record.transfer(omega, record.theta)
    factor = gain if slope is None else slopes[slope]
    columns, ends = series.T.reshape(-1, len(series)), _Ends.of(before, after)
    found = np.zeros(columns.shape)
    moving = np.flatnonzero(columns.any(axis=1))  # what is zero stays zero: most of a load's derivatives
    for first in range(0, len(moving), at_once := max(1, FILTER_BATCH // length)):
        part = moving[first : first + at_once]
        lines = scipy.fft.rfft(ends.added_to(columns[part]))
        lines *= factor
        found[part] = scipy.fft.irfft(lines, n=length, overwrite_x=True)[:, before : length - after]
    return found.reshape(series.T.shape).T


def _extension(samples: int) -> tuple[int, int]:
    """Samples before and after a run: an eighth of it, and as many more as a fast Fourier transform needs."""
    least = min(samples - 1, max(64, samples // 8))
    after = scipy.fft.next_fast_len(samples + 2 * least, real=True) - samples - least
    return least, min(after, samples - 1)


@dataclass(frozen=True, eq=False)
class _Ends:
    """Ends of a run, cross-faded so that it closes periodically.

    rise  (before,) weights of the point reflection at the start, from 0 to 1
    fall  (after,) weights of that at the end, from 1 to 0
    """

    rise: Array
    fall: Array

    @classmethod
    def of(cls, before: int, after: int) -> _Ends:
        """Of as many samples before and after a run; 0 for a run that is periodic already."""
        rise, fall = np.cos(np.linspace(0, np.pi, before)), np.cos(np.linspace(0, np.pi, after))
        return cls(0.5 - 0.5 * rise, 0.5 + 0.5 * fall)

    def added_to(self, series: Array) -> Array:
        """Series (c, n) extended by their point reflections at both ends, (c, before + n + after)."""
        before, after, samples = len(self.rise), len(self.fall), series.shape[1]
        if not before:
            return series
        whole = np.empty((len(series), before + samples + after))
        first, own, last = np.split(whole, [before, before + samples], axis=1)
        middle = (series[:, :1] + series[:, -1:]) / 2
        own[:] = series
        np.subtract(2 * series[:, :1] - middle, series[:, before:0:-1], out=first)
        np.subtract(2 * series[:, -1:] - middle, series[:, -2 : -after - 2 : -1], out=last)
        for part, weights in ((first, self.rise), (last, self.fall)):
            part *= weights
            part += middle
        return whole
