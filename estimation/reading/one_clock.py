"""One clock: series of several clocks brought onto that of the wrench, their offset estimated, repeats cut."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.reading.clock_offset import MotionRegressors, clock_offset
from estimation.reading.gravity_vector import ACCELERATION, RATES
from estimation.reading.log_reader import Array
from estimation.reading.repeat_cutting import CutSeries, aligned_runs, cut_into_repeats, one_run, separate_runs
from estimation.reading.sample_mending import ROUNDING, Series, Stream, interpolated_position, interpolated_quaternion
from estimation.reading.step_log import StepLog
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.differentiation import TrueSamples
from estimation.recordings.motion import QUATERNION
from estimation.recordings.motion_period import FEWEST_SAMPLES
from estimation.recordings.reading import recording_from_table
from estimation.recordings.reading_report import OffsetReading, PeriodReading
from modeling.errors import InputError
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, STANDARD_GRAVITY, Rig

SMALLEST_SHIFT = 0.05
"""Of a sample: a smaller offset is not worth an interpolation."""

SAME_STAMPS = 0.9
"""Share of the wrench's stamps that the motion's hold exactly, from which on one clock has stamped both."""
CLIPPED = 0.05
"""Of a sample: by so much a sample of the wrench may lie outside the motion, which is taken as its end then."""
FEW_MISSING = 0.2
"""Share of a column's cells below which empty ones are interpolated; of more the column would be invented."""
HELD = " held "
"""Before the name of a column, as no log has it, that holds the last value of a slower series."""
SLOWER = 1.5
"""Steps of the wrench from which on a motion is slower, and is held for two rows or more as a rule."""
ZERO_STD = 2
"""Standard deviations: an offset within 95 % of zero is none."""
NAMED_OFFSETS = 3
"""Offsets that would fit as well that a message names."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommonClock:
    """Columns (n,), `time` among them, at one rate, Hz."""

    columns: Mapping[str, Array]
    rate: float
    offset: OffsetReading | None
    period: PeriodReading | None = None


def on_one_clock(
    series: Sequence[Series],
    stated_offset: float | None,
    period: float | None,
    rig: Rig | None,
    log: StepLog,
    shared: bool,
    whole: bool = False,
    same_stamps: bool = False,
    polled: float | None = None,
    hold: bool = False,
) -> CommonClock:
    """All series at the instants of the first, which holds the wrench: that is the one with noise to keep white.

    Cut into repeats where the motion has a period; `whole` keeps one run. With the `same_stamps` in both, somebody has
    brought them onto one clock: an offset is estimated and said, and not applied. Of series that were `polled` by the
    rows of one log, s, each may be older than its row: an offset within one is estimated. With `hold` those that are
    slower than the wrench are held, too, beside what is interpolated: of its true samples a motion is rebuilt better.

    Motion of other series is interpolated there by cubic splines, orientation on the sphere; other columns linearly.
    """
    wrench, others = series[0], series[1:]
    offset = None
    if others and stated_offset is not None:
        offset = OffsetReading(offset=stated_offset, std=0.0, applied=True, correlation=1.0)
    elif others and not shared:
        offset = _estimated(wrench, others, rig, log, same_stamps)
    elif others and polled is not None:
        estimate = _estimated(wrench, others, rig, StepLog(), same_stamps=False)
        is_of_polling = estimate is not None and estimate.applied and abs(estimate.offset) <= polled
        offset = estimate if is_of_polling else None
    shift = offset.offset if offset is not None and offset.applied else 0.0
    if shift:
        text = f"stamps of the wrench moved by {-shift * 1e3:.4g} ms"
        log.mended(text, wrench.where, wrench.samples)
    columns = dict(wrench.columns)
    if others:
        columns = _with_motion(columns, wrench, others, wrench.instants - shift, log, hold=hold and shared)
    columns = _finite(columns, wrench.where, log)
    cut = _cut(columns, wrench, period, log, whole=whole)
    return CommonClock(columns=cut.columns, rate=1 / cut.dt, offset=offset, period=cut.period)


def _with_motion(
    columns: Mapping[str, Array],
    wrench: Series,
    others: Sequence[Series],
    instants: Array,
    log: StepLog,
    *,
    hold: bool,
) -> dict[str, Array]:
    """Columns of the wrench, those of other series beside them, at its instants (n,) that all of them cover."""
    slack = CLIPPED * wrench.dt
    low = max(one.start for one in others) - slack
    high = min(one.instants[-1] for one in others) + slack
    inside = (instants >= low) & (instants <= high)
    if inside.sum() < FEWEST_SAMPLES:
        what = f"the stamps of {wrench.where} and {others[0].where} do not overlap"
        remedy = "give logs of one run, or state the offset: --clock-offset 12.3 (s)"
        raise InputError(what=what, where=wrench.where, remedy=remedy)
    joined = {name: column[inside] for name, column in columns.items()}
    for one in others:
        if hold and one.dt > SLOWER * wrench.dt:
            latest = np.searchsorted(one.instants, instants[inside] + slack, side="right") - 1
            held = {name: column[np.maximum(latest, 0)] for name, column in one.columns.items()}
            if TrueSamples.of(held.values(), wrench.dt, int(inside.sum())) is not None:
                joined |= {f"{HELD}{name}": column for name, column in held.items()}
        joined |= _at(one, instants[inside])
        log.taken(f"interpolated from {1 / one.dt:.6g} Hz at the samples of the wrench", one.where, int(inside.sum()))
    return joined


def _cut(columns: dict[str, Array], wrench: Series, period: float | None, log: StepLog, *, whole: bool) -> CutSeries:
    """The columns in repeats: the runs that the wrench has, or those of its motion's period."""
    lengths = np.array(wrench.lengths)
    if wrench.runs > 1 and np.ptp(lengths) > 0:
        return aligned_runs(columns, wrench.dt, lengths, wrench.where, log)
    if wrench.runs > 1:
        return separate_runs(columns, wrench.dt, wrench.runs)
    return one_run(columns, wrench.dt) if whole else cut_into_repeats(columns, wrench.dt, period, wrench.where, log)


def _at(series: Series, instants: Array) -> dict[str, Array]:
    """The columns of a series at other instants."""
    stamps = series.instants
    columns: dict[str, Array] = {}
    if set(QUATERNION) <= set(series.columns):
        quaternions = np.stack([series.columns[name] for name in QUATERNION], axis=1)
        columns |= dict(zip(QUATERNION, interpolated_quaternion(stamps, quaternions, instants).T, strict=True))
    for name, column in series.columns.items():
        if name in columns:
            continue
        smooth = name[0] in "pq" and bool(np.isfinite(column).all())
        columns[name] = (
            interpolated_position(stamps, column[:, None], instants)[:, 0]
            if smooth
            else np.interp(instants, stamps, column)
        )
    return columns


def _estimated(
    wrench: Series, others: Sequence[Series], rig: Rig | None, log: StepLog, same_stamps: bool
) -> OffsetReading | None:
    """The offset between the clocks of wrench and motion, where the motion's kinematics are known."""
    motion = others[0]
    start, stop = max(o.start for o in others), min(o.instants[-1] for o in others)
    instants = motion.instants[(motion.instants >= start - ROUNDING) & (motion.instants <= stop + ROUNDING)]
    columns = {name: column for one in others for name, column in _at(one, instants).items()}
    channels = PLANAR_CHANNELS if "tau" in wrench.columns else SPATIAL_CHANNELS
    dummy = {channel: np.zeros(len(instants)) for channel in channels}
    names = [n for n in columns if n[0] in "pq" or n in (*RATES, *ACCELERATION)]
    table = ColumnTable(
        columns={"time": instants - instants[0], **{n: columns[n] for n in names}, **dummy},
        where=motion.where,
        first_row=1,
    )
    try:
        signals = recording_from_table(table, name=motion.where, rig=rig).signals
    except InputError as error:
        log.suspicious(f"the clock offset against {wrench.where} is not estimated: {error.what}", motion.where)
        return None
    gravity = STANDARD_GRAVITY if rig is None else rig.gravity
    regressors = MotionRegressors.of(signals, instants, gravity)
    apart = wrench.start > instants[-1] or wrench.instants[-1] < instants[0]
    around = wrench.start - float(instants[0]) if apart else 0.0
    if apart:
        log.suspicious(
            f"its clock begins {around:.6g} s after that of {motion.where}: their first samples are aligned",
            wrench.where,
        )
    offset = clock_offset(regressors, wrench.instants, np.stack([wrench.columns[c] for c in channels], axis=1), around)
    if offset is None:
        log.suspicious(
            f"too short to estimate its clock offset against {motion.where}; the stamps are believed", wrench.where
        )
        return None
    return _judged(offset, wrench, motion, log, same_stamps)


def _judged(reading: OffsetReading, wrench: Series, motion: Series, log: StepLog, same_stamps: bool) -> OffsetReading:
    """The offset, applied where it is known and differs from zero by more than its interval and a part of a sample.

    Between streams with the same stamps it is not applied: what the rigid tool lacks looks like an offset, too.
    """
    if not reading.applied:
        what = f"the clock offset against {motion.where} cannot be estimated from this motion;"
        what += " the stamps are believed, unless --clock-offset states it (s)"
        log.suspicious(what, wrench.where)
        return reading
    if reading.alternatives:
        others = ", ".join(f"{offset:.3g}" for offset in reading.alternatives[:NAMED_OFFSETS])
        log.suspicious(
            f"the motion is periodic: an offset of {others} s would fit as well; the smallest is taken", wrench.where
        )
    small = abs(reading.offset) < max(ZERO_STD * reading.std, SMALLEST_SHIFT * wrench.dt)
    if same_stamps and not small:
        what = (
            f"seems {reading.offset * 1e3:.3g} ms late against {motion.where}, whose stamps are the same: not applied,"
        )
        what += " as what acts on the tool besides its weight looks like that, too; a delay is left to the diagnosis,"
        what += " unless --clock-offset (clock_offset=) states an offset of the clocks, s"
        log.suspicious(what, wrench.where)
    return replace(reading, applied=not small and not same_stamps)


def have_same_stamps(streams: Sequence[Stream]) -> bool:
    """Whether the stamps of the first stream, the wrench, are those of another one, but for a few that were lost."""
    first, *others = (stream.stamps for stream in streams)
    return any(np.isin(first, other).mean() > SAME_STAMPS for other in others)


def _finite(columns: Mapping[str, Array], where: str, log: StepLog) -> dict[str, Array]:
    """Auxiliary columns with empty cells interpolated where few are missing, else left out."""
    complete = {}
    for name, column in columns.items():
        missing = int((~np.isfinite(column)).sum())
        if missing and missing < FEW_MISSING * len(column):
            finite = np.flatnonzero(np.isfinite(column))
            column = np.interp(np.arange(len(column)), finite, column[finite])
            log.mended(f"empty cells of {name} interpolated", where, missing, len(column))
        elif missing:
            log.taken(f"{name} is left out: mostly empty", where, missing, len(column))
            continue
        complete[name] = np.round(column) if name == "repeat" else column
    return complete
