"""Reading curves: what a picture of a reading shows, of a size that does not grow with the log's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.reports.decimation import Array, min_max_decimated

MOST_SPANS = 400
"""Intervals that a picture can tell apart; nearer ones are one."""
INTERVAL_BINS, LONGEST_INTERVAL = 80, 4.0
"""Bins of a histogram of sampling intervals, and its end in medians."""
Span: TypeAlias = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingCurves:
    """A recording's channels over time, where it was cut, and the directions that gravity took in the sensor.

    channels  by name instants (k,), s, and values (k,), SI: the smallest and largest of each of a few hundred parts
    units     of the channels, "" where unknown
    time      first and last instant, s; None for static poses, whose instants are their numbers
    cuts      instants at which the second and further repeats begin, s
    gravity   directions of gravity in the sensor's axes, (k, 3), or (k, 2) in the plane; None where unknown
    """

    channels: Mapping[str, tuple[Array, Array]]
    units: Mapping[str, str]
    time: Span | None
    cuts: tuple[float, ...]
    gravity: Array | None

    @classmethod
    def of(
        cls, columns: Mapping[str, Array], units: Mapping[str, str], stamps: Array | None, gravity: Array | None
    ) -> Self:
        """Of a recording's columns (n,) at stamps (n,) in s, or poses in their order."""
        samples = len(next(iter(columns.values())))
        instants = np.arange(1.0, samples + 1) if stamps is None else stamps
        start = 0.0 if stamps is None else float(stamps[0])
        shown = {name: column for name, column in columns.items() if name not in ("time", "repeat")}
        cuts = np.flatnonzero(np.diff(columns["repeat"])) + 1 if "repeat" in columns else ()
        return cls(
            channels={name: _decimated(instants, column, start) for name, column in shown.items()},
            units=units,
            time=None if stamps is None else (0.0, float(stamps[-1]) - start),
            cuts=tuple(float(instants[cut]) - start for cut in cuts),
            gravity=gravity,
        )


def _decimated(instants: Array, column: Array, start: float) -> tuple[Array, Array]:
    """Instants since the start, and values, in arrays of their own: none that keeps the whole column in memory."""
    x, y = min_max_decimated(instants, column)
    return x - start, y.copy()


@dataclass(frozen=True, kw_only=True, eq=False)
class IntervalHistogram:
    """Intervals between neighbouring stamps as they were read: counts (k,) between edges (k + 1,), s.

    not_increasing  how many are zero or negative, and longer  how many lie beyond the last edge; in neither bin
    """

    edges: Array
    counts: NDArray[np.int64]
    not_increasing: int
    longer: int

    @classmethod
    def of(cls, stamps: Array) -> Self | None:
        """Of stamps (n,) in s in the order of the log; None without an increasing pair."""
        steps = np.diff(stamps[np.isfinite(stamps)])
        positive = steps[steps > 0]
        if not len(positive):
            return None
        counts, edges = np.histogram(positive, INTERVAL_BINS, (0.0, LONGEST_INTERVAL * float(np.median(positive))))
        return cls(
            edges=edges, counts=counts, not_increasing=len(steps) - len(positive), longer=len(positive) - counts.sum()
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetCurves:
    """Why a clock offset is what it is.

    offsets, share        (k,) s, and the share of the wrench's variance that weight and inertia force explain
    near, chi_square      (j,) s about the estimate, and the whole model's chi-square above its minimum
    instants              (m,) s of a part of the record, on the motion's clock by the offset, of one channel:
    measured              (m,) readings, SI
    as_stamped, aligned   (m,) what weight and inertia force explain of them by the stamps, and by the offset
    """

    offsets: Array
    share: Array
    near: Array
    chi_square: Array
    channel: int
    instants: Array
    measured: Array
    as_stamped: Array
    aligned: Array


def spans(stamps: Array, of_samples: NDArray[np.bool_] | NDArray[np.int64]) -> tuple[Span, ...]:
    """Intervals of stamps (n,) that hold these samples, a mask or indices; neighbours are one interval."""
    index = np.flatnonzero(of_samples) if of_samples.dtype == bool else of_samples
    index = index[np.isfinite(stamps[index])]
    if not len(index):
        return ()
    apart = np.flatnonzero(np.diff(index) > 1) + 1
    runs = np.split(index, apart) if len(apart) < 100 * MOST_SPANS else [index]
    return merged([(float(stamps[run[0]]), float(stamps[run[-1]])) for run in runs])


def merged(found: Sequence[Span]) -> tuple[Span, ...]:
    """The intervals in order; where there are too many to be told apart, near ones as one."""
    ordered = sorted((min(span), max(span)) for span in found)
    if len(ordered) <= MOST_SPANS:
        return tuple(ordered)
    near = (max(end for _, end in ordered) - ordered[0][0]) / MOST_SPANS
    joined = [ordered[0]]
    for start, end in ordered[1:]:
        if start - joined[-1][1] < near:
            joined[-1] = (joined[-1][0], max(joined[-1][1], end))
        else:
            joined.append((start, end))
    return tuple(joined)
