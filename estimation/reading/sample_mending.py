"""Sample mending: rows with stamps become samples of a uniform clock, without gaps, and every step is logged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from estimation.reading.log_reader import Array
from estimation.reading.step_log import StepLog
from estimation.recordings.motion_period import FEWEST_SAMPLES
from estimation.recordings.reading import (
    JITTER_WINDOW,
    LATE_STEP,
    LONGEST_FILL,
    STEP_TOLERANCE,
    missing_samples,
    wander,
)
from estimation.recordings.reading_report import ClockReading, Span, merged, spans
from modeling.errors import InputError

SLIGHT_DIFFERENCE, SLIGHT_SAMPLES = 0.02, 3
"""Share of a repeat, and samples, by which repeats may differ in length and be of one motion still."""

Index = NDArray[np.int64]


def repeat_lengths(repeat: Array) -> Index:
    """Rows of each repeat in a column that counts them."""
    return np.diff(np.concatenate([[0], np.flatnonzero(np.diff(repeat)) + 1, [len(repeat)]])).astype(np.int64)


def differ_slightly(lengths: Index) -> bool:
    """Whether repeats are of different length, but of one motion still."""
    usual = float(np.median(lengths))
    difference = float(np.abs(lengths - usual).max())
    return int(np.ptp(lengths)) > 0 and difference <= slight_difference(usual) < usual / 2


def slight_difference(length: float) -> float:
    """Samples by which repeats of this length may differ."""
    return max(SLIGHT_SAMPLES, SLIGHT_DIFFERENCE * length)


# Resampling of series at other instants: cubic for smooth series, spherical linear or cubic for orientation,
# band-limited for readings with noise.


REACH = 64
"""Samples to either side that a band-limited interpolation uses."""
KAISER = 8.0
"""Shape of its Kaiser window: with this reach it passes 96 % of the band, and rejects images by 80 dB and more."""
FRACTIONS = 2048
"""Positions between two samples for which weights are tabulated; between them they are linear, to 1e-7."""
ROWS_AT_ONCE = 4096
"""Places that are interpolated at once: their windows are 4 MB a column."""
CUBIC_POINTS = 4
"""Points that determine a cubic."""
LARGEST_CUBIC_TURN = 0.3
"""Radians between neighbours, above which the components of a quaternion bend more than a cubic follows."""


def band_limited(values: Array, places: Array) -> Array:
    """Series (n, k) at places (m,), in samples, by a sinc under a Kaiser window.

    Noise keeps its spectrum, white noise stays white with the same variance: linear or cubic interpolation would take
    up to half of its upper frequencies away, at some places more than at others. Beyond its ends the series is
    continued by odd reflection.
    """
    reach = min(REACH, len(values) - 1)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    windows = sliding_window_view(padded, 2 * reach, axis=0)
    table = _weights(reach)
    interpolated = np.empty((len(places), values.shape[1]))
    for start in range(0, len(places), ROWS_AT_ONCE):
        inside = np.clip(places[start : start + ROWS_AT_ONCE], 0, len(values) - 1)
        base = np.floor(inside).astype(np.intp)
        fraction = (inside - base) * FRACTIONS
        row = np.minimum(fraction.astype(np.intp), FRACTIONS - 1)
        share = (fraction - row)[:, None]
        weights = table[row] * (1 - share) + table[row + 1] * share
        interpolated[start : start + ROWS_AT_ONCE] = np.einsum("mkj,mj->mk", windows[base + 1], weights)
    return interpolated


def _weights(reach: int) -> Array:
    """Weights (fractions + 1, 2 reach) of the samples 1 - reach .. reach about a place, of sum one."""
    distance = np.linspace(0, 1, FRACTIONS + 1)[:, None] - np.arange(1 - reach, reach + 1)
    window = np.i0(KAISER * np.sqrt(np.maximum(1 - (distance / reach) ** 2, 0.0)))
    weights = np.sinc(distance) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def interpolated_position(stamps: Array, values: Array, instants: Array) -> Array:
    """Cubic spline (not-a-knot) through smooth values (n, k) at increasing stamps (n,), at the instants (m,).

    A sampled motion has its power far below half the sampling rate, where a cubic spline is band-limited interpolation
    to (f dt)^4. Outside the stamps the end values hold.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    inside = np.clip(instants, stamps[0], stamps[-1])
    if len(stamps) < CUBIC_POINTS:
        return np.stack([np.interp(inside, stamps, column) for column in values.T], axis=1)
    return np.asarray(CubicSpline(stamps, values)(inside))


def interpolated_quaternion(stamps: Array, quaternions: Array, instants: Array) -> Array:
    """Orientations (m, 4) at the instants, from unit quaternions (n, 4), x y z w, at increasing stamps (n,).

    Slerp between the neighbours, plus what a cubic spline of the rotation vector relative to slerp's chord adds is, for
    small steps, a cubic spline of the sign-continuous components, normalised: its error is of order (omega dt)^4, that
    of slerp (alpha dt²)/8. Where a step is larger than `LARGEST_CUBIC_TURN`, all are taken by slerp.
    """
    from scipy.spatial.transform import Rotation, Slerp  # slow to import

    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    cosine = np.sum(unit[1:] * unit[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(cosine < 0, -1.0, 1.0)]))
    unit = unit * signs[:, None]
    inside = np.clip(instants, stamps[0], stamps[-1])
    if len(stamps) < CUBIC_POINTS or 2 * np.arccos(np.clip(np.abs(cosine).min(), 0, 1)) > LARGEST_CUBIC_TURN:
        return np.asarray(Slerp(stamps, Rotation.from_quat(unit))(inside).as_quat())
    components = interpolated_position(stamps, unit, inside)
    return np.asarray(components / np.linalg.norm(components, axis=1, keepdims=True))


NEIGHBOURS = 6
"""Samples on either side of a filled gap that its cubic goes through."""
MOST_UNEVEN = 100
"""Mean step over the median one, above which stamps are damaged: samples taken on events are less uneven."""
COARSE_SHARE = 0.05
"""Of the rows with other values at the stamp of the row before, from which stamps are coarse."""
RESTART_SHARE, RESTART_STEPS = 0.01, 50
"""Of the record's length, and usual steps, by which time falls back where another run begins; rows out of order are
nearer."""
WHOLE_TOLERANCE, WHOLE_SHARE = 0.3, 0.99
"""Of a step, and share of the steps that are as near to a whole number of them, so that rounding counts the samples."""
FEW_LATE = 0.01
"""Share of late steps from which gaps are so near to each other that a long window would hold several."""
SHORT_WINDOW = JITTER_WINDOW // 4
"""Samples over which stamps are compared then."""
MENDED_WANDER, MENDED_WANDER_SHARE = 1.5, 0.002
"""Samples, and share of the record, by which stamps may leave a uniform clock and are put on it still."""
SAME_INSTANT = 0.05
"""Of a step: a sample so soon after another is the same one, and would bend a spline."""
ROUNDING = 1e-9
"""Seconds by which an instant on the end of an interval may lie outside it."""
STAMP = " stamp"
"""Column, under a name that no log has, that takes the stamps through all that is done to the rows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """Columns (n,) with stamps (n,) in s as read. `essential` ones are needed; elsewhere NaN is allowed."""

    where: str
    stamps: Array
    columns: Mapping[str, Array]
    essential: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Columns (m,) at start + i dt, s on the clock of the stamps; several runs restart, each of its length."""

    where: str
    start: float
    dt: float
    columns: Mapping[str, Array]
    reading: ClockReading
    lengths: tuple[int, ...] = ()

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return max(len(self.lengths), 1)

    @property
    def samples(self) -> int:
        """The number of samples m."""
        return len(next(iter(self.columns.values())))

    @property
    def instants(self) -> Array:
        """Stamps of the samples (m,), s."""
        return np.asarray(self.start + self.dt * np.arange(self.samples), dtype=np.float64)


def mended_runs(stream: Stream, log: StepLog) -> Series:
    """The stream on a uniform clock; where time restarts and `repeat` counts, its runs, if about equally long."""
    repeat = stream.columns.get("repeat")
    starts = np.flatnonzero(np.diff(stream.stamps) < 0) + 1
    if repeat is None or not starts.size or not (repeat[starts] != repeat[starts - 1]).all():
        return mended(stream, log)
    laid = replace(stream, stamps=_end_to_end(stream.stamps, starts))
    pieces = [_piece(laid, rows) for rows in np.split(np.arange(len(repeat)), starts)]
    if min(len(piece.stamps) for piece in pieces) < FEWEST_SAMPLES:
        return mended(stream, log)
    attempt = StepLog(strict=log.strict)
    runs = [mended(piece, attempt) for piece in pieces]
    lengths = np.array([run.samples for run in runs])
    alike = np.ptp(lengths) == 0 or differ_slightly(lengths)
    if not alike or np.ptp([run.dt for run in runs]) * runs[0].samples > runs[0].dt:
        return mended(stream, log)
    log.steps.extend(attempt.steps)
    log.taken(f"time restarts: {len(runs)} runs of one motion", stream.where)
    columns = {name: np.concatenate([run.columns[name] for run in runs]) for name in runs[0].columns}
    return replace(runs[0], columns=columns, lengths=tuple(run.samples for run in runs))


def _end_to_end(stamps: Array, starts: Index) -> Array:
    """Stamps of which each run, from these rows on, begins one usual step after the end of the one before."""
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    steps[starts - 1] = usual
    return np.asarray(stamps[0] + np.concatenate([[0.0], np.cumsum(steps)]))


def _piece(stream: Stream, rows: Index) -> Stream:
    columns = {name: column[rows] for name, column in stream.columns.items()}
    return replace(stream, stamps=stream.stamps[rows], columns=columns)


def mended(stream: Stream, log: StepLog, *, with_gaps: bool = False) -> Series:
    """The stream on a uniform clock, or `with_gaps` all of its rows, with their stamps in the column `STAMP`.

    InputError when too little of it is left.
    """
    total = len(stream.stamps)
    rows = _timed_rows(stream, log)
    rows = _increasing_rows(stream, rows, log)
    if len(rows) < FEWEST_SAMPLES:
        what = f"only {len(rows)} of {total} rows can be used"
        raise InputError(what=what, where=stream.where, remedy="record longer, or state the columns in a map")
    stamps = stream.stamps[rows]
    ticks = _ticks(stamps)
    if with_gaps:
        steps = np.diff(stamps)
        dt = float(np.median(steps))
        jitter = float(np.std(steps[steps < LATE_STEP * dt])) / np.sqrt(2)
        columns = {name: column[rows] for name, column in stream.columns.items()} | {STAMP: stamps}
        clock = _reading(stream.where, len(rows), dt, stamps, jitter)
        return Series(where=stream.where, start=float(stamps[0]), dt=dt, columns=columns, reading=clock)
    begin, end = _longest_piece(stamps, ticks, stream.where, log)
    rows, stamps, ticks = rows[begin:end], stamps[begin:end], ticks[begin:end] - ticks[begin]
    dt, start, deviation = _line(stamps, ticks)
    if _is_irregular(deviation / dt):
        return _regular(stream, rows, stamps, log)
    reading = _reading(stream.where, len(rows), dt, stamps, float(np.std(deviation)))
    whole = len(rows) == total and bool((np.diff(rows) == 1).all())
    columns = {name: column if whole else column[rows] for name, column in stream.columns.items()}
    if ticks[-1] + 1 > len(ticks):
        missing = int(ticks[-1] + 1 - len(ticks))
        is_missing = np.ones(int(ticks[-1]) + 1, dtype=bool)
        is_missing[ticks] = False
        at = spans(start + dt * np.arange(len(is_missing), dtype=np.float64), is_missing)
        log.mended("missing samples interpolated", stream.where, missing, len(is_missing), at, stream.columns)
        columns = {name: _filled(column, ticks) for name, column in columns.items()}
    return Series(where=stream.where, start=start, dt=dt, columns=columns, reading=reading)


def _reading(where: str, samples: int, dt: float, stamps: Array, jitter: float) -> ClockReading:
    seconds = float(stamps[-1] - stamps[0])
    return ClockReading(
        where=where, samples=samples, rate=1 / dt, start=float(stamps[0]), seconds=seconds, jitter=jitter
    )


def _timed_rows(stream: Stream, log: StepLog) -> Index:
    timed = np.isfinite(stream.stamps)
    if not timed.all():
        log.mended("rows without time left out", stream.where, int((~timed).sum()), len(timed))
    return np.flatnonzero(timed)


def _increasing_rows(stream: Stream, rows: Index, log: StepLog) -> Index:
    """Rows in the order of time, each sample once; where time restarts, the longest run."""
    rows = _longest_run(stream, rows, log)
    stamps = stream.stamps[rows]
    back = int((np.diff(stamps) < 0).sum())
    if back:
        at = spans(stamps[1:], np.diff(stamps) < 0)
        log.mended("rows put in the order of time", stream.where, back, len(rows), at, stream.columns)
        rows = rows[np.argsort(stamps, kind="stable")]
        stamps = stream.stamps[rows]
    same = np.flatnonzero(np.diff(stamps) == 0) + 1
    if not same.size:
        return rows
    differs = np.zeros(len(same), dtype=bool)
    for name in stream.essential:
        differs |= stream.columns[name][rows[same]] != stream.columns[name][rows[same - 1]]
    if differs.sum() > COARSE_SHARE * len(rows):
        log.taken(
            "stamps are too coarse to tell neighbouring samples apart; their order is used",
            stream.where,
            int(differs.sum()),
            len(rows),
        )
        same = same[~differs]
    elif differs.any():
        what, at = "samples with the stamp of the one before left out", spans(stamps, same[differs])
        log.mended(what, stream.where, int(differs.sum()), len(rows), at, stream.columns)
    if int((~differs).sum()):
        at = spans(stamps, same[~differs])
        log.mended("doubled rows left out", stream.where, int((~differs).sum()), len(rows), at, stream.columns)
    return np.delete(rows, same)


def _longest_run(stream: Stream, rows: Index, log: StepLog) -> Index:
    """Where time falls back by more than `RESTART_SHARE` of a run, another run begins."""
    stamps = stream.stamps[rows]
    if len(rows) < FEWEST_SAMPLES:
        return rows
    fall = np.diff(stamps)
    far = max(RESTART_SHARE * float(np.ptp(stamps)), RESTART_STEPS * float(np.median(np.abs(fall))))
    restarts = np.flatnonzero(fall < -far) + 1
    if not restarts.size:
        return rows
    runs = np.split(rows, restarts)
    longest = max(runs, key=len)
    log.mended(
        f"time restarts: the longest of {len(runs)} runs is kept", stream.where, len(rows) - len(longest), len(rows)
    )
    return longest


def _ticks(stamps: Array) -> Index:
    """Number of each sample on the clock, missing ones counted.

    Where nearly all steps are whole multiples of the median one, by rounding them; else by lasting delays. A gap that
    will be cut counts as the shortest such, however long it is.
    """
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    plain = steps[np.abs(steps - usual) < STEP_TOLERANCE * usual]
    usual = float(plain.mean()) if len(plain) else usual
    counts = np.minimum(np.round(steps / usual), LONGEST_FILL + 2)
    offs = np.abs(steps / usual - np.round(steps / usual))
    if np.quantile(offs, WHOLE_SHARE) < WHOLE_TOLERANCE and (counts >= 1).all():
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    extra = np.zeros(len(stamps), dtype=np.int64)
    few = (steps > LATE_STEP * usual).mean() < FEW_LATE
    for i, lost in missing_samples(stamps, JITTER_WINDOW if few else SHORT_WINDOW):
        extra[i] = round(min(max(lost, 1), LONGEST_FILL + 1))
    return np.arange(len(stamps)) + np.cumsum(extra)


def _longest_piece(stamps: Array, ticks: Index, where: str, log: StepLog) -> tuple[int, int]:
    """First and last index of the longest piece without a long gap."""
    cuts = np.flatnonzero(np.diff(ticks) > LONGEST_FILL + 1) + 1
    if not cuts.size:
        return 0, len(ticks)
    bounds = np.concatenate([[0], cuts, [len(ticks)]])
    piece = int(np.argmax(np.diff(bounds)))
    begin, end = int(bounds[piece]), int(bounds[piece + 1])
    longest = float(np.diff(stamps)[cuts - 1].max())
    gaps = "1 gap" if len(cuts) == 1 else f"{len(cuts)} gaps"
    kept = f"the longest piece is kept, {stamps[end - 1] - stamps[begin]:.4g} s"
    what = f"{gaps} of up to {longest:.3g} s: {kept}"
    left_out: list[Span] = [
        (float(stamps[first]), float(stamps[last - 1])) for first, last in pairwise(bounds) if first != begin
    ]
    log.mended(what, where, len(ticks) - (end - begin), len(ticks), merged(left_out))
    return begin, end


def _line(stamps: Array, ticks: Index) -> tuple[float, float, Array]:
    """Step and start of the straight line through the stamps, and their deviation from it."""
    centred = ticks - ticks.mean()
    dt = float(centred @ (stamps - stamps.mean()) / (centred @ centred))
    line = stamps.mean() + dt * centred
    return dt, float(line[0]), stamps - line


def _is_irregular(deviation: Array) -> bool:
    """Whether the stamps wander from the clock so much that the samples are better interpolated.

    Sooner than where a recording is refused for it, as an interpolation costs less than a refusal.
    """
    return wander(deviation) > max(MENDED_WANDER, MENDED_WANDER_SHARE * len(deviation))


def _regular(stream: Stream, rows: Index, stamps: Array, log: StepLog) -> Series:
    """The stream interpolated at the median rate, where the samples were taken irregularly."""
    steps = np.diff(stamps)
    dt = float(np.median(steps[steps > 0]))
    apart = np.concatenate([[True], steps > SAME_INSTANT * dt])
    rows, stamps = rows[apart], stamps[apart]
    mean = float(stamps[-1] - stamps[0]) / len(stamps)
    if mean > MOST_UNEVEN * dt:
        what = f"its stamps step by {dt:.3g} s as a rule, and by {mean:.3g} s on average: many are damaged"
        raise InputError(what=what, where=stream.where, remedy="correct them, or state in a map: rate = 500 (Hz)")
    instants = np.arange(stamps[0], stamps[-1] + ROUNDING, dt)
    log.mended(f"sampled irregularly: interpolated at {1 / dt:.6g} Hz", stream.where, len(instants))
    columns = {name: np.interp(instants, stamps, column[rows]) for name, column in stream.columns.items()}
    smooth = [name for name in stream.essential if name[0] in "pq"]
    if smooth:
        values = np.stack([stream.columns[name][rows] for name in smooth], axis=1)
        columns |= dict(zip(smooth, interpolated_position(stamps, values, instants).T, strict=True))
    reading = _reading(stream.where, len(rows), dt, stamps, float(np.std(steps)))
    return Series(where=stream.where, start=float(stamps[0]), dt=dt, columns=columns, reading=reading)


def _filled(column: Array, ticks: Index) -> Array:
    """The column on all ticks; a local cubic spline through its neighbours fills each gap.

    No filled sample lies beyond all others: of a channel that clips it would hide the level.
    """
    low, high = (float(bound(column)) for bound in (np.fmin.reduce, np.fmax.reduce))
    full = np.full(int(ticks[-1]) + 1, np.nan)
    full[ticks] = column
    for i in np.flatnonzero(np.diff(ticks) > 1):
        near = slice(max(int(i) + 1 - NEIGHBOURS, 0), int(i) + 1 + NEIGHBOURS)
        gap = np.arange(ticks[i] + 1, ticks[i + 1])
        finite = np.isfinite(column[near])
        if finite.any():
            at = (ticks[near][finite]).astype(np.float64)
            filled = interpolated_position(at, column[near][finite][:, None], gap.astype(np.float64))[:, 0]
            full[gap] = np.clip(filled, low, high)
    return full
