"""Windows of a series in which a transient event is sought: candidates, refinement, sums, and the samples in them.

Three detectors search such windows, each with a Bonferroni correction for all windows and channels. Their statistics
differ because they know different things of the series:

`events_in_repeats`      the noise spectrum at the non-excited lines, whatever the model: the score of a pulse by
                         generalised least squares beside drift and leakage, chi-square over the channels
`events_in_single_runs`  neither the noise nor the tip's parameters: the likelihood of a fit without the window, then
                         Student's t of a constant wrench in it
`contact_detection`      the prediction, up to a systematic residual and a zero: the mean over its standard deviation
                         under the noise of the samples outside all windows found, several windows at once
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
SampleMask = NDArray[np.bool_]
Window = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Windows:
    """w windows of a series, samples first <= t < last, each (w,)."""

    first: Indices
    last: Indices

    @classmethod
    def of_lengths(cls, lengths: Indices, samples: int, strides: ArrayLike = 1) -> Windows:
        """Windows of these lengths (l,) within a number of samples, starts a `stride` apart, one for each length."""
        pairs = zip(lengths, np.broadcast_to(strides, lengths.shape), strict=True)
        starts = [np.arange(0, samples + 1 - length, stride) for length, stride in pairs]
        first = np.concatenate(starts)
        return cls(first, first + np.repeat(lengths, [len(s) for s in starts]))

    @classmethod
    def near(cls, window: Window, samples: int, *, step: int, reach: int, shortest: int) -> Windows:
        """A window with each end moved by up to `reach` steps, within the samples and not shorter than `shortest`."""
        moves = step * np.arange(-reach, reach + 1)
        first, last = (ends.ravel() for ends in np.meshgrid(window[0] + moves, window[1] + moves, indexing="ij"))
        kept = (first >= 0) & (last <= samples) & (last - first >= shortest)
        return cls(first[kept], last[kept])

    def __len__(self) -> int:
        return len(self.first)

    def best(self, score: Array) -> Window:
        """The window of the largest score (w,)."""
        index = int(np.argmax(score))
        return int(self.first[index]), int(self.last[index])

    def sums(self, cumulative: Array) -> Array:
        """Sum over each window, (w, ...), from a series' cumulative sums (n + 1, ...)."""
        return np.asarray(cumulative[self.last] - cumulative[self.first])

    def best_disjoint(self, gain: Array) -> list[int]:
        """Disjoint windows of the largest sum of gains (w,), by their end.

        Weighted interval scheduling: best[t] = max(best[t - 1], best[first] + gain of the windows that end at t), at
        the ends t in order.
        """
        gainful = np.flatnonzero(gain > 0)  # the others never add to the sum
        order = gainful[np.argsort(self.last[gainful], kind="stable")]
        gain = gain[order]
        ends, starts = np.unique(self.last[order], return_index=True)
        before = np.searchsorted(ends, self.first[order], "right")  # the ends up to where each window begins
        best, choice = np.zeros(len(ends) + 1), np.full(len(ends) + 1, -1)
        for end, (start, stop) in enumerate(pairwise([*starts.tolist(), len(order)]), start=1):
            total = best[before[start:stop]] + gain[start:stop]
            largest = total.argmax()
            best[end] = best[end - 1]
            if total[largest] > best[end]:
                best[end], choice[end] = total[largest], start + largest
        chosen, end = list[int](), len(ends)
        while end > 0:
            if choice[end] >= 0:
                chosen.append(int(order[choice[end]]))
            end = end - 1 if choice[end] < 0 else int(before[choice[end]])
        return chosen[::-1]


def cumulative_sums(series: Array) -> Array:
    """Sums (n + 1, ...) of the first 0 .. n samples of a series (n, ...)."""
    return np.concatenate([np.zeros((1, *series.shape[1:])), np.cumsum(series, axis=0)])


def variances_of_sums(autocovariance: Array) -> Array:
    """Variances (n, ...) of sums over 1 .. n successive samples with autocovariance g (n, ...) at lags 0 .. n - 1.

    Over L samples it is L g_0 + 2 sum_{k<L} (L - k) g_k.
    """
    lengths = np.arange(1, len(autocovariance) + 1).reshape(-1, *[1] * (autocovariance.ndim - 1))
    return np.asarray(2 * np.cumsum(np.cumsum(autocovariance, axis=0), axis=0) - lengths * autocovariance[0])


def inside(windows: Iterable[Window], samples: int) -> SampleMask:
    """Samples (n,) in any of the windows."""
    selected = np.zeros(samples, dtype=bool)
    for first, last in windows:
        selected[first:last] = True
    return selected


def samples_of(event: tuple[float, float], step: float, samples: int) -> Window:
    """Samples of an event (s) in a series with this `step` (s); at least two."""
    first, last = (int(np.clip(round(edge / step), 0, samples)) for edge in event)
    return first, max(last, first + 2)
