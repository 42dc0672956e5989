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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.effects.disturbances import RAMP_TIME

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
SampleMask = NDArray[np.bool_]
Window = tuple[int, int]
Interval = tuple[float, float]


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


SHAPE_DEGREE = 3
"""Of the polynomial between two edges of an event: a half sine between its edges is followed to a thousandth."""
MARGIN = 1 / 8
"""Of an event's length, on either side of it, that its shape includes: where a slow push begins is lost in noise."""
MAX_EDGES = 16
"""Edges of an event: what has more levels and bends than these is no event of some shape, but something else."""
LONGEST_EVENT = 0.5
"""Of the recording: what lasts longer is no event."""
DEPENDENT = 1e-6
"""Singular value, of orthonormal columns less their mean, below which a direction is that mean."""


@dataclass(frozen=True)
class EventShape:
    """An event whose wrench is not constant: a cubic between any two successive `edges` (s), and in a margin beside.

    judged  whether its mean wrench is left to an effect, a contact from the first edge to the last
    """

    edges: tuple[float, ...]
    judged: bool

    @property
    def interval(self) -> tuple[float, float]:
        """Its begin and end (s)."""
        return self.edges[0], self.edges[-1]

    @property
    def margin(self) -> float:
        """How far its shape reaches beyond either end, s."""
        return MARGIN * (self.edges[-1] - self.edges[0])

    def touches(self, event: tuple[float, float]) -> bool:
        """Whether another event (s) is not farther from it than the margins of both."""
        apart = self.margin + MARGIN * (event[1] - event[0])
        return event[0] < self.edges[-1] + apart and event[1] > self.edges[0] - apart

    def columns(self, time: Array) -> Array:
        """Orthonormal series (n, k) over times (s) that span its shapes."""
        parts = []
        for start, end in pairwise((self.edges[0] - self.margin, *self.edges, self.edges[-1] + self.margin)):
            rows = np.flatnonzero((time >= start) & (time < end))
            if len(rows):
                part = np.zeros((len(time), min(SHAPE_DEGREE + 1, len(rows))))
                powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(rows)), part.shape[1] - 1)
                part[rows] = np.linalg.qr(powers)[0]
                parts.append(part)
        return np.hstack(parts) if parts else np.zeros((len(time), 0))

    def unjudged_columns(self, time: Array) -> Array:
        """Orthonormal series (n, k) of its shapes over times (s), of a judged one without the mean between its ends.

        The samples in which a contact's pulse rises or falls are free, so that its times, which are given, are left.
        """
        columns = self.columns(time)
        if not self.judged:
            return columns
        rises = [elapsed / float(RAMP_TIME) + 0.5 for elapsed in (time - self.edges[0], self.edges[-1] - time)]
        pulse = np.clip(np.minimum(*rises), 0.0, 1.0)
        partial = np.flatnonzero((pulse > 0) & (pulse < 1))
        mean = pulse == 1
        free = np.hstack([columns - np.outer(mean, mean @ columns) / mean.sum(), np.eye(len(time))[:, partial]])
        left, values, _ = np.linalg.svd(free, full_matrices=False)
        return np.asarray(left[:, values > DEPENDENT])


def event_shapes(
    shapes: Sequence[EventShape],
    contact: Interval,
    events: Sequence[Interval],
    detected: Sequence[Interval],
    longest: float,
) -> tuple[EventShape, ...]:
    """Shapes of the events of a recording, given those (s) that are left beside a contact (s), and beside `shapes`.

    What touches the contact is of it, up to a length `longest` (s); any other is an event that no effect stands for.
    Of the events that were `detected` before, only the ends of the contact are taken.
    """
    whole = [shape for shape in shapes if shape.judged] or [EventShape(contact, judged=True)]
    whole += [shape for shape in shapes if not shape.judged]
    for event in events:
        of_it = [shape for shape in whole if shape.touches(event)] or [EventShape(event, judged=False)]
        edges = sorted({*event, *(edge for shape in of_it for edge in shape.edges)})
        if len(edges) <= MAX_EDGES and edges[-1] - edges[0] <= longest:
            joined = EventShape(tuple(edges), of_it[0].judged)
            whole = [joined if shape is of_it[0] else shape for shape in whole if shape not in of_it[1:]]
            whole += [] if joined in whole else [joined]
    first = whole[0]
    if len(first.edges) == 2:
        return tuple(whole[1:])
    edges = sorted({*first.edges, *(edge for event in detected if first.touches(event) for edge in event)})
    ends = {edges[0], edges[-1]} if edges[-1] - edges[0] <= longest else set()
    return (EventShape(tuple(sorted({*first.edges, *ends})), judged=True), *whole[1:])
