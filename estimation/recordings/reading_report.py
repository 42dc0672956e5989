"""Reading report: what came from which source, what was done to how many samples, what is suspicious."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from modeling.table import Column, Table, Tabular

Array: TypeAlias = NDArray[np.float64]

PIXEL_COLUMNS = 360
"""Width of a panel in pixels."""


def min_max_decimated(x: Array, y: Array, bins: int = PIXEL_COLUMNS) -> tuple[Array, Array]:
    """The smallest and the largest y in each of `bins` equal intervals of samples, in order."""
    if len(y) <= 2 * bins:
        return x, y
    return extremes(x, y, np.linspace(0, len(y), bins + 1).astype(int))


def extremes(x: Array, y: Array, edges: NDArray[np.intp]) -> tuple[Array, Array]:
    """The smallest and the largest y between consecutive indices, in order."""
    parts = [(start, y[start:end]) for start, end in pairwise(edges)]
    index = np.unique([start + i for start, piece in parts for i in (int(piece.argmin()), int(piece.argmax()))])
    return x[index], y[index]


# Reading curves: what a picture of a reading shows, of a size that does not grow with the log's.


MOST_SPANS = 400
"""Intervals that a picture can tell apart; nearer ones are one."""
SPLIT_SPANS = 100 * MOST_SPANS
"""Intervals up to which samples are told apart before near ones are merged; more would take seconds."""
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
    runs = np.split(index, apart) if len(apart) < SPLIT_SPANS else [index]
    return merged([(float(stamps[run[0]]), float(stamps[run[-1]])) for run in runs])


def merged(intervals: Sequence[Span]) -> tuple[Span, ...]:
    """The intervals in order; where there are too many to be told apart, near ones as one."""
    ordered = sorted((min(span), max(span)) for span in intervals)
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


Z_95 = 1.96
"""Standard deviations of a normal estimate on either side of a 95 % interval."""
LEAST_SHARE = 1e-4
"""Below which a share is said to be less than that."""
FINEST_STD = 1e-9
"""Seconds: finer digits of a period are rounding of the stamps."""
SHOWN_NAMES = 3
"""Columns that are named one by one; of more the first and the last."""
FINEST_PERIOD = 1e-6
"""Resolution with which a period is written, s."""
FINEST_JITTER = 1e-6
"""Below it a jitter is rounding of the stamps, s."""


class StepKind(Enum):
    """Taken as it stands or as stated; mended, so that samples were changed, moved or left out; suspicious."""

    TAKEN = "taken"
    MENDED = "mended"
    SUSPICIOUS = "suspicious"


@dataclass(frozen=True, kw_only=True)
class ReadingStep:
    """One thing that was done or noticed; `count` of `total` samples where it concerns samples.

    at        when, as intervals, s from the recording's first sample; none where it concerns all of the time
    channels  which of the recording's columns it concerns; none where it concerns all of the source
    """

    kind: StepKind
    what: str
    where: str
    count: int | None = None
    total: int | None = None
    at: tuple[Span, ...] = ()
    channels: tuple[str, ...] = ()

    def __str__(self) -> str:
        share = (
            "" if self.count is None else f" ({self.count}" + ("" if self.total is None else f" of {self.total}") + ")"
        )
        return f"{self.where}: {self.what}{share}"


@dataclass(frozen=True)
class Assumption:
    """A unit, order or frame that nothing states, `kind` and `value` as a map calls them, and why the numbers show it.

    It is taken so where it is `adopted`, else proposed. `remedy`: how it is stated, where that is no line of a map.
    """

    kind: str
    value: str
    why: str
    adopted: bool = True
    remedy: str = ""


@dataclass(frozen=True, kw_only=True)
class UsedColumns:
    """What became which columns of the recording, and how it was read."""

    quantity: str
    source: str
    columns: tuple[str, ...]
    targets: tuple[str, ...]
    how: str


@dataclass(frozen=True, kw_only=True)
class ClockReading:
    """A clock: samples read, rate (Hz), first stamp and length (s), std of the stamps about it (s), their intervals."""

    where: str
    samples: int
    rate: float
    start: float
    seconds: float
    jitter: float
    intervals: IntervalHistogram | None = field(default=None, compare=False)


@dataclass(frozen=True, kw_only=True)
class OffsetReading:
    """Wrench stamp minus motion stamp of the same instant, s, its std and 95 % interval; whether it was applied."""

    offset: float
    std: float
    applied: bool
    correlation: float
    alternatives: tuple[float, ...] = ()
    curves: OffsetCurves | None = field(default=None, compare=False)

    @property
    def is_estimated(self) -> bool:
        """Whether it was applied, and nobody stated it."""
        return self.applied and self.std > 0

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, s."""
        return self.offset - Z_95 * self.std, self.offset + Z_95 * self.std


@dataclass(frozen=True, kw_only=True)
class PeriodReading:
    """Period of the motion, s, and its std; whole repeats of it, and samples in each.

    deviation, chance  root-mean-square of what does not repeat over that of the motion, beyond its noise, and what
                       chance adds to that
    correlation        of the motion with itself a period later
    before, after      s that were left out before the first and after the last whole repeat
    """

    period: float
    std: float
    repeats: int
    samples: int
    deviation: float
    chance: float
    correlation: float
    before: float
    after: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, s."""
        return self.period - Z_95 * self.std, self.period + Z_95 * self.std

    def __str__(self) -> str:
        digits = int(np.clip(1 - np.floor(np.log10(max(self.std, FINEST_STD))), 2, 6))
        text = f"The motion repeats: period {self.period:.{digits}f} s (95 % interval {_half_width(Z_95 * self.std)}),"
        text += f" {self.repeats} whole repeats of {self.samples} samples. What does not repeat is"
        text += f" {_percent(self.deviation)} of the motion"
        return text + (f" (chance adds up to {_percent(self.chance)})." if self.chance > LEAST_SHARE else ".")


def _jitter(clock: ClockReading) -> float:
    """In ms; 0 where it is rounding."""
    return 1e3 * clock.jitter if clock.jitter >= FINEST_JITTER else 0.0


def _half_width(seconds: float) -> str:
    """Of an interval, s; one that is finer than the digits of the period is said to be."""
    return f"± {seconds:.1g} s" if seconds >= FINEST_PERIOD else "below 1 µs"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share > LEAST_SHARE else "less than 0.01 %"


@dataclass(frozen=True, kw_only=True)
class ReadingReport(Tabular):
    """How sources became a recording of `samples` rows at `rate` Hz (None for static poses).

    `held` has the rows for which each quantity is held where that is so of the wrench, `assumptions` what nothing
    states, `euler` the convention by which Euler angles were read. `curves` are what `tw.plot_reading` draws of the
    recording; text and JSON are without them.
    """

    sources: tuple[tuple[str, str, int, int], ...]
    used: tuple[UsedColumns, ...]
    clocks: tuple[ClockReading, ...]
    offset: OffsetReading | None
    steps: tuple[ReadingStep, ...]
    samples: int
    rate: float | None
    columns: tuple[str, ...]
    period: PeriodReading | None = None
    held: Mapping[str, int] = field(default_factory=dict)
    assumptions: tuple[Assumption, ...] = ()
    euler: str = ""
    curves: ReadingCurves | None = field(default=None, compare=False)

    def of(self, kind: StepKind) -> tuple[ReadingStep, ...]:
        """The steps of one kind, in their order."""
        return tuple(step for step in self.steps if step.kind is kind)

    @property
    def size(self) -> str:
        """Samples, length and rate, in words."""
        rate = "static poses" if self.rate is None else f"{self.samples / self.rate:.4g} s at {self.rate:.6g} Hz"
        return f"{self.samples} samples, {rate}"

    def to_data(self) -> dict[str, Any]:
        """The report as plain data, s and Hz."""
        data: dict[str, Any] = {
            "sources": [dict(zip(("name", "kind", "rows", "columns"), s, strict=True)) for s in self.sources],
            "columns": [{**vars(u), "columns": list(u.columns), "targets": list(u.targets)} for u in self.used],
            "clocks": [_without(clock, "intervals") for clock in self.clocks],
            "offset": None if self.offset is None else _offset_data(self.offset),
            "period": None if self.period is None else {**vars(self.period), "interval": list(self.period.interval)},
            "steps": [_without(step, "at", "channels") | {"kind": step.kind.value} for step in self.steps],
            "recording": {"samples": self.samples, "rate": self.rate, "columns": list(self.columns)},
        }
        return data

    @property
    def table(self) -> Table:
        """What became which columns."""
        rows = [[u.quantity, u.source, _shortened(u.columns), u.how] for u in self.used]
        return Table.of(("quantity", "source", "columns", "read as"), rows)

    def printed(self) -> list[Table | str]:
        """Sources, columns, clocks, the offset between them, and every step by its kind."""
        parts: list[Table | str] = [f"Recording: {self.size}; {', '.join(self.columns)}"]
        parts.append(
            Table.of(("source", "kind", "rows", "columns"), [(n, k, str(r), str(c)) for n, k, r, c in self.sources])
        )
        parts.append(self.table)
        if self.clocks:
            columns = (Column("rate", "Hz", ".6g"), Column("length", "s", ".4g"), Column("jitter", "ms", ".2g"))
            parts.append(Table.of(("clock", *columns), [(c.where, c.rate, c.seconds, _jitter(c)) for c in self.clocks]))
        if self.offset is not None:
            parts.append(_offset_sentence(self.offset))
        if self.period is not None:
            parts.append(str(self.period))
        by_title = {title: self.of(kind) for kind, title in _TITLES.items()}
        return parts + [
            "\n".join([f"{title}:", *(f"  {step}" for step in steps)]) for title, steps in by_title.items() if steps
        ]

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.printed()))


_TITLES: Mapping[StepKind, str] = {
    StepKind.TAKEN: "How it was read",
    StepKind.MENDED: "Mended",
    StepKind.SUSPICIOUS: "Suspicious",
}


def _without(described: object, *names: str) -> dict[str, Any]:
    return {name: value for name, value in vars(described).items() if name not in names}


def _offset_data(offset: OffsetReading) -> dict[str, Any]:
    lists = {"interval": list(offset.interval), "alternatives": list(offset.alternatives)}
    return _without(offset, "curves") | lists


def _offset_sentence(offset: OffsetReading) -> str:
    if offset.std == 0:
        return f"Clock offset: {offset.offset * 1e3:.6g} ms as stated; applied."
    low, high = (bound * 1e3 for bound in offset.interval)
    text = f"Clock offset: the wrench's stamps are {offset.offset * 1e3:.2f} ms late against the motion's"
    text += f" (95 % interval {low:.2f} to {high:.2f} ms)"
    return text + ("; applied." if offset.applied else "; not applied.")


def _shortened(names: tuple[str, ...]) -> str:
    return ", ".join(names) if len(names) <= SHOWN_NAMES else f"{names[0]} .. {names[-1]}"
