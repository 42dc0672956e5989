"""Recording from a file or from columns, with validation errors that name row and column."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.multiplicity import normal_isf
from estimation.recordings.column_table import (
    ColumnTable,
    import_remedy,
    table_from_columns,
    table_from_file,
)
from estimation.recordings.motion import MIN_POSES, QUATERNION, Motion, MotionColumns, MotionForm, numbered_names
from estimation.recordings.motion_period import FEWEST_SAMPLES
from estimation.recordings.recording import Recording
from estimation.recordings.weight_fit import SMALLEST_DIVISOR
from modeling.errors import InputError
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig
from modeling.space import Space

if TYPE_CHECKING:
    from estimation.recordings.dwells import Dwells

JOINT_ANGLE = re.compile(r"q[1-9]\d*")
Array: TypeAlias = NDArray[np.float64]
KINEMATICS = {Space.PLANE: "link_lengths", Space.SPACE: "urdf"}


def _record(table: ColumnTable) -> str:
    return f"record it, rename the column that holds it, or {import_remedy(table.where)}"


def wrench_channels(table: ColumnTable) -> tuple[str, ...]:
    """The channels of the table's wrench; InputError when it is incomplete or mixed."""
    planar, spatial = (
        [channel for channel in channels if channel in table.columns]
        for channels in (PLANAR_CHANNELS, SPATIAL_CHANNELS)
    )
    lone = [channel for channel in spatial if channel not in PLANAR_CHANNELS]
    if "tau" in planar and lone:
        what = f"a mixed wrench: the planar tau together with {', '.join(lone)}"
        raise table.error(what, "keep fx, fy, tau or fx, fy, fz, tx, ty, tz")
    expected, present = (SPATIAL_CHANNELS, spatial) if lone else (PLANAR_CHANNELS, planar)
    missing = [channel for channel in expected if channel not in present]
    if not present:
        raise table.error("no wrench: fx, fy, tau or fx, fy, fz, tx, ty, tz are missing", _record(table))
    if missing:
        raise table.error(f"the wrench is missing {_listed(missing)}", _record(table))
    return expected


def motion_form(table: ColumnTable, channels: tuple[str, ...], rig: Rig | None) -> MotionForm:
    """The first complete form of motion, in the order of FORMATS, that is compatible with this wrench."""
    space = Space.PLANE if channels == PLANAR_CHANNELS else Space.SPACE
    forms = (MotionForm.JOINTS, MotionForm.PLANAR_POSE if space is Space.PLANE else MotionForm.POSE)
    obstacles = {form: _missing(form, table, rig, space) for form in forms}
    for form, obstacle in obstacles.items():
        if obstacle is None:
            return form
    for form, obstacle in obstacles.items():
        if obstacle is not None and _has_any_column(form, table):
            raise table.error(*obstacle)
    other = "phi" if space is Space.PLANE else _listed(QUATERNION)
    raise table.error(f"the motion is missing: neither q1..qn nor {other}", _record(table))


def _has_any_column(form: MotionForm, table: ColumnTable) -> bool:
    """Whether the table has any column of this form, so that the missing ones are named."""
    if form is MotionForm.JOINTS:
        return bool(_joint_angles(table))
    names = ("phi", "ax", "ay") if form is MotionForm.PLANAR_POSE else QUATERNION
    return any(name in table.columns for name in names)


def _joint_angles(table: ColumnTable) -> list[str]:
    angles = (name for name in table.columns if JOINT_ANGLE.fullmatch(name))
    return sorted(angles, key=lambda name: int(name[1:]))


def _missing(form: MotionForm, table: ColumnTable, rig: Rig | None, space: Space) -> tuple[str, str] | None:
    """What is missing of a form of motion, and the remedy; None when it is complete."""
    if form is MotionForm.JOINTS:
        return _missing_joints(table, rig, space)
    needed = ["phi"] if form is MotionForm.PLANAR_POSE else list(QUATERNION)
    if form is MotionForm.PLANAR_POSE and ("ax" in table.columns) != ("ay" in table.columns):
        needed += ["ax", "ay"]
    missing = [name for name in needed if name not in table.columns]
    return (f"the motion is missing {_listed(missing)}", _record(table)) if missing else None


def _missing_joints(table: ColumnTable, rig: Rig | None, space: Space) -> tuple[str, str] | None:
    angles, kinematics = _joint_angles(table), KINEMATICS[space]
    arm = None if rig is None else rig.arm
    if arm is None or arm.space is not space:
        lacks = "no rig was given" if rig is None else f"the rig has no {kinematics}"
        return f"columns {_listed(angles)} are joint angles, and {lacks}", f"give a rig with robot.{kinematics}"
    expected = numbered_names("q", arm.joints)
    missing = [name for name in expected if name not in angles]
    if missing:
        return f"the motion is missing {_listed(missing)}", f"record every joint of robot.{kinematics}"
    extra = [name for name in angles if name not in expected]
    if extra:
        noun = kinematics if space is Space.PLANE else "joints"
        what = f"columns {_listed(extra)} are joint angles beyond the rig's {len(expected)} {noun}"
        return what, f"give a rig whose {kinematics} has them, or rename the column"
    return None


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


# Uniform sample clock by least squares from jittering time stamps.


JITTER_WINDOW = 50
"""Most samples over which stamps are compared: longer than a burst of a buffered driver."""
WINDOWS = 10
"""Windows that a short record has at least, or its medians would hide where it wanders."""
MISSING_SAMPLE_STEP = 0.75
"""Samples of lasting delay in the stamps from which samples count as missing: one, less a quarter for jitter."""
LATE_STEP = 1.5
"""Usual steps from which a step may hide a missing sample: half way between one step and two."""
BURST_STEP = 0.75
"""Mean steps below which the median one shows that a driver hands samples over in bursts."""
BURST_QUANTILE, BURST_SLACK = 0.98, 0.4
"""Of the steps, the one before each burst is among the longest fiftieth; by so much more of a step it may jitter."""
CHANCE_STD = 5
"""Of the delay's median, whose own error is 1.25 std / sqrt(m): four times that is not by chance."""
STEP_TOLERANCE = 0.5
"""Of the median step, by which another may differ and be one step still: half way to none and to two."""
REGULAR_SHARE = 0.8
"""Of the steps that are alike in stamps; those of a measured quantity are alike in fewer."""
MOST_WANDER, WANDER_SHARE = 3.0, 0.01
"""Samples, and share of the record, by which stamps may leave a uniform clock in a recording."""
LONGEST_FILL = 5
"""Samples in a row that are interpolated; a longer gap cuts the recording."""
SEPARATE_STEP = 3
"""Steps between the last sample of a repeat and the first of the next, above which a pause separates them."""


def is_regular(column: Array) -> bool:
    """Whether most steps of a column (n,) are alike, as no measured quantity's are; rows without a number count not."""
    steps = np.diff(column[np.isfinite(column)])
    middle = float(np.median(steps)) if len(steps) else 0.0
    return middle > 0 and bool((np.abs(steps - middle) < STEP_TOLERANCE * middle).mean() > REGULAR_SHARE)


def wander(deviation: Array) -> float:
    """By how much stamps wander from a clock as jitter does not: the largest median of a window of deviations (n,)."""
    window = _window(len(deviation))
    pieces = np.array_split(deviation, max(len(deviation) // window, 1))
    return max(abs(float(np.median(piece))) for piece in pieces)


def _window(samples: int, most: int = JITTER_WINDOW) -> int:
    return min(max(samples // WINDOWS, 1), most)


def require_increasing(stamps: Array, where: str, first_row: int, remedy: str, before: float = -np.inf) -> None:
    """InputError, with a remedy, for stamps (n,) of which one is not later than that before it.

    first_row  the row of the first stamp in its file; before, the stamp that precedes it
    """
    wrong = np.flatnonzero(np.diff(stamps, prepend=before) <= 0)
    if wrong.size:
        i = int(wrong[0])
        earlier = stamps[i - 1] if i else before
        what = f"time does not increase at row {first_row + i} ({earlier:.9g} s, then {stamps[i]:.9g} s)"
        raise InputError(what=what, where=where, remedy=remedy)


@dataclass(frozen=True, kw_only=True)
class SampleClock:
    """A uniform clock: stamp of its first sample and step, in s."""

    start: float
    dt: float

    @classmethod
    def of(cls, stamps: NDArray[np.float64], *, where: str = "time", first_row: int = 2) -> SampleClock:
        """The straight line through the stamps (n,) in s, by least squares.

        A stamp is taken when the driver received the sample, so it jitters; the samples themselves were taken by a
        uniform clock (FORMATS, `time`), so that the line replaces the stamps. `first_row` is the row of the
        first stamp in its file. Raises InputError where time does not increase, where samples are missing
        and where the stamps follow no uniform clock.
        """
        stamps = np.asarray(stamps, dtype=float)
        remedy = "sort the rows, or number separate runs in `repeat`"
        require_increasing(stamps, where, first_row, remedy)
        _require_no_missing_samples(stamps, where, first_row)
        count = np.arange(len(stamps)) - (len(stamps) - 1) / 2
        dt = float(count @ stamps / (count @ count))
        _require_uniform_rate(stamps - stamps.mean() - dt * count, dt, where)
        return cls(start=float(stamps.mean() + dt * count[0]), dt=dt)

    def times(self, samples: int) -> NDArray[np.float64]:
        """Seconds since the first sample."""
        return np.arange(samples, dtype=np.float64) * np.float64(self.dt)


def _require_no_missing_samples(stamps: NDArray[np.float64], where: str, first_row: int) -> None:
    for i, lost in missing_samples(stamps):
        what = f"a gap in time at row {first_row + i}: about {max(round(lost), 1)} samples are missing"
        what += f" after {stamps[i - 1]:.9g} s"
        raise InputError(what=what, where=where, remedy="use the longer piece, or record without a gap")


def missing_samples(stamps: NDArray[np.float64], window: int = JITTER_WINDOW) -> Iterator[tuple[int, float]]:
    """Index of each increasing stamp before which samples are missing, and how many, in samples.

    A delayed stamp is followed by punctual ones; after missing samples all stamps stay delayed.
    """
    window = _window(len(stamps), window)
    step = float(np.median(stamps[window:] - stamps[:-window])) / window
    delay = stamps / step - np.arange(len(stamps))
    steps = np.diff(stamps) / step
    # A driver that hands over bursts makes a long step before each of them; only longer ones are gaps.
    bursts = float(np.median(steps)) < BURST_STEP
    usual = float(np.quantile(steps, BURST_QUANTILE)) + BURST_SLACK if bursts else LATE_STEP
    suspected = np.flatnonzero(steps > usual) + 1
    if not suspected.size:
        return
    jitter = float(np.median(np.abs(steps - np.median(steps)))) / normal_isf(0.25) / np.sqrt(2)
    for i in suspected:
        before, after = delay[max(i - window, 0) : i], delay[i : i + window]
        lost = float(np.median(after) - np.median(before))
        chance = CHANCE_STD * jitter * np.sqrt(1 / len(before) + 1 / len(after))
        if lost > max(MISSING_SAMPLE_STEP, chance):
            yield int(i), lost


def _require_uniform_rate(delay: NDArray[np.float64], dt: float, where: str) -> None:
    deviation = wander(delay) / dt
    if deviation > max(MOST_WANDER, WANDER_SHARE * len(delay)):
        what = f"the time stamps deviate by {deviation:.0f} samples from a uniform clock"
        raise InputError(what=what, where=where, remedy="resample at a uniform rate, or record at one")


CLOSE, SMOOTH = 0.05, 0.8
"""Radians between the rows of a run, and correlation of one increment with the next; poses have more, and less."""
LONG_RUN = 100
"""Rows: more static poses than anybody takes in an order as smooth."""
LONG_STEP, SLOWEST = 0.3, 0.01
"""s and rad/s: nobody records a run as slowly, of a motion as slow."""
FASTEST_QUANTILE = 0.99
"""Of the speeds, the one that is taken as the fastest: damaged rows are fewer than a hundredth."""
STILL = 0.5
"""Radians by which a sensor that stands still does not turn."""
NEARLY_TIME = re.compile(
    r"(?:.*[^a-z])?(?:time|stamps?|time_?stamps?|clock|secs?|seconds|t)(?:[^a-z].*)?|time_?[a-z]{1,3}", re.IGNORECASE
)
BY_MAP = "bring the log in by `truewrench import` or `tw.read` with a map"
NORM_TOLERANCE = 1e-2
"""Of a unit quaternion: errors of printed digits and interpolation are far smaller."""


def read(path: str | Path, *, rig: Rig | None = None) -> Recording:
    """The recording in one CSV or Parquet file with the columns of FORMATS, SI units, as `tw.read` describes it.

    `rig` gives the kinematics that joint angles need. Raises InputError, in one line with file and row or column, for
    whatever cannot be a recording. Rows are counted with a CSV's header as row 1.
    """
    path = Path(path)
    return recording_from_table(table_from_file(path), name=path.name, rig=rig)


def from_columns(columns: Mapping[str, ArrayLike], *, name: str = "recording", rig: Rig | None = None) -> Recording:
    """The recording in columns (n,) by name, as `read` takes them from a file; rows are counted from 1."""
    return recording_from_table(table_from_columns(columns, name), name=name, rig=rig)


def recording_from_table(table: ColumnTable, *, name: str, rig: Rig | None) -> Recording:
    """The recording in a table with the columns of FORMATS; InputError for whatever cannot be one."""
    channels = wrench_channels(table)
    form = motion_form(table, channels, rig)
    _require_direction(table, rig, 2 if channels == PLANAR_CHANNELS else 3)
    repeats = _repeats(table)
    _require_samples(table, repeats)
    if "time" not in table.columns:
        _require_poses(table)
    if form is MotionForm.JOINTS:
        _require_radians(table, rig)
    if form is MotionForm.POSE:
        _require_unit_norm(table)
    try:
        time, continuous = _time(table, repeats)
    except InputError:
        poses = _poses_between_gaps(table, form, channels, name, rig) if repeats == 1 else None
        if poses is None:
            raise
        return poses
    if time is not None:
        _require_seconds(table, float(time[1] - time[0]))
    return _recording(table, channels, name, Motion(MotionColumns({}, time, repeats, continuous), form, rig))


def _recording(table: ColumnTable, channels: tuple[str, ...], name: str, motion: Motion) -> Recording:
    """The recording of a table's columns with the time and the repeats of a motion."""
    time = motion.recorded.time
    others = {key: values for key, values in table.columns.items() if key not in (*channels, "time", "repeat")}
    wrench = np.stack([table.columns[channel] for channel in channels], axis=1)
    for values in (wrench, *others.values(), *(() if time is None else (time,))):
        values.flags.writeable = False
    return Recording(
        name=name, channels=channels, wrench=wrench,
        motion=replace(motion, recorded=replace(motion.recorded, columns=others)),
    )  # fmt: skip


def _poses_between_gaps(
    table: ColumnTable, form: MotionForm, channels: tuple[str, ...], name: str, rig: Rig | None
) -> Recording | None:
    """The dwells of a log that no uniform clock follows, as static poses; None of any other."""
    stamps = table.columns["time"]
    dwells = None if (np.diff(stamps) <= 0).any() else dwells_between_gaps(table.columns, form, channels, stamps)
    rows = _recording(table, channels, name, Motion(MotionColumns({}, None), form, rig))
    return None if dwells is None else rows.at_dwells(dwells)


def dwells_between_gaps(
    columns: Mapping[str, Array], form: MotionForm, channels: Sequence[str], stamps: Array
) -> Dwells | None:
    """The dwells of a log with increasing stamps (n,), s, maybe with gaps between; None where it is not of them."""
    from estimation.recordings.dwells import Dwells  # of a log with gaps alone

    gaps = np.zeros(len(stamps) - 1, dtype=bool)
    gaps[[i - 1 for i, lost in missing_samples(stamps) if lost > LONGEST_FILL]] = True
    dwells = Dwells.of(columns, form, stamps, np.stack([columns[channel] for channel in channels], axis=1), gaps)
    return dwells if dwells.are_poses else None


def _require_poses(table: ColumnTable) -> None:
    """Raise InputError where rows without `time` are no static poses but a run: its time is called otherwise, or lost.

    Increments of a run are alike from row to row; those of poses are not, though several rows may be taken in each.
    """
    stamps = [name for name in table.columns if NEARLY_TIME.fullmatch(name) and _is_clock(table.columns[name])]
    if stamps:
        what = f"there is no column time, and {stamps[0]} increases steadily as one: a run, or static poses?"
        remedy = f"name it time, in s, or {BY_MAP}; for static poses remove {stamps[0]}"
        raise table.error(what, remedy)
    increments = np.diff(_angles(table), axis=1)
    step = float(np.median(np.linalg.norm(increments, axis=0)))
    if increments.shape[1] > LONG_RUN and 0 < step < CLOSE and _lag_correlation(increments) > SMOOTH:
        what = f"there is no column time, and neighbouring rows differ by {step:.2g} rad as those of a run do"
        remedy = f"add it, or {BY_MAP} that has its rate, rate = 500 (Hz)"
        raise table.error(f"{what}: a run without its time, not static poses", remedy)


def _lag_correlation(increments: Array) -> float:
    """Correlation of increments (k, n) with the next ones, about zero: 1 of a smooth motion, -1/2 of random poses."""
    product = float((increments[:, 1:] * increments[:, :-1]).sum())
    return product / max(float((increments**2).sum()), SMALLEST_DIVISOR)


def _require_seconds(table: ColumnTable, dt: float) -> None:
    """Raise InputError where the whole motion is slower than any: its time is in ms, us or ns."""
    if dt < LONG_STEP:
        return
    steps = _steps(table)
    fastest = float(np.quantile(steps, FASTEST_QUANTILE)) / dt
    if fastest < SLOWEST and steps.sum() > STILL:
        what = f"time steps by {dt:.6g}, and the motion is no faster than {fastest:.2g} rad/s if that is in seconds:"
        remedy = f'give time in s, or {BY_MAP} that has units = {{ time = "ms" }}'
        raise table.error(f"{what} milliseconds or nanoseconds?", remedy)


def _steps(table: ColumnTable) -> Array:
    """Angles by which the rows (n - 1,) turn from one to the next, rad."""
    return np.asarray(np.linalg.norm(np.diff(_angles(table), axis=1), axis=0))


def _angles(table: ColumnTable) -> Array:
    """Joint angles, a planar angle, or twice a quaternion without jumps of its sign, (k, n)."""
    if not set(QUATERNION) <= set(table.columns):
        names = [name for name in table.columns if JOINT_ANGLE.fullmatch(name) or name == "phi"]
        return np.stack([table.columns[name] for name in names])
    q = np.stack([table.columns[name] for name in QUATERNION])
    flips = (q[:, 1:] * q[:, :-1]).sum(axis=0) < 0
    return np.asarray(2 * q * np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 0, 1.0, -1.0))


def _is_clock(column: Array) -> bool:
    """Whether a column increases from row to row by steps that are mostly alike."""
    return is_regular(column) and bool((np.diff(column) >= 0).all())


def _require_direction(table: ColumnTable, rig: Rig | None, axes: int) -> None:
    direction = None if rig is None else rig.gravity_direction
    if direction is not None and len(direction) != axes:
        what = f"the rig's gravity_direction has {len(direction)} components, and this wrench is of {axes} axes"
        raise table.error(what, f"give gravity_direction along the {axes} axes of the base")


def _repeats(table: ColumnTable) -> int:
    """Number of repeats: numbered by integers, contiguous rows, equally many samples each."""
    if "repeat" not in table.columns:
        return 1
    repeat = table.columns["repeat"]
    fractional = np.flatnonzero(repeat != np.round(repeat))
    if fractional.size:
        what = f"column repeat is {repeat[fractional[0]]:g} at row {table.row(int(fractional[0]))}"
        raise table.error(what, "number the repeats with integers")
    starts = np.concatenate([[0], np.flatnonzero(np.diff(repeat)) + 1])
    again = np.setdiff1d(np.arange(len(starts)), np.unique(repeat[starts], return_index=True)[1])
    if again.size:
        start = int(starts[again[0]])
        what = f"repeat {repeat[start]:g} occurs again at row {table.row(start)}: its rows are not contiguous"
        raise table.error(what, "sort the rows by repeat, then by time")
    _require_equal(table, repeat, starts)
    return len(starts)


def _require_equal(table: ColumnTable, repeat: Array, starts: NDArray[np.int64]) -> None:
    counts = np.diff(np.append(starts, len(repeat)))
    usual = int(max(counts, key=lambda count: (np.sum(counts == count), count)))
    if (counts != usual).any():
        i = int(np.argmax(np.abs(counts - usual)))
        what = f"repeat {repeat[starts[i]]:g}, from row {table.row(int(starts[i]))} on, has {counts[i]} samples"
        remedy = (
            "cut the repeats to one period each, or leave an incomplete one out, as `truewrench import` and"
            " `tw.read(..., period=...)` do"
        )
        raise table.error(f"{what} and others {usual}", remedy)


def _require_samples(table: ColumnTable, repeats: int) -> None:
    samples = len(table) // repeats
    least, noun = (FEWEST_SAMPLES, "samples") if "time" in table.columns else (MIN_POSES, "static poses")
    if samples < least:
        each = "" if repeats == 1 else " in each repeat"
        what = f"too few {noun}{each}: {samples}, and at least {least} are needed"
        raise table.error(what, "record longer" if noun == "samples" else "record more poses, or a time column")


def _time(table: ColumnTable, repeats: int) -> tuple[Array | None, bool]:
    """Uniform time (n,) from 0 on, and whether the repeats are continuous, without a pause between them."""
    if "time" not in table.columns:
        return None, repeats == 1
    runs = table.columns["time"].reshape(repeats, -1)
    gaps = runs[1:, 0] - runs[:-1, -1]
    # A pause between repeats separates them as a restart does: Fourier lines of the whole record do not span it.
    pause = SEPARATE_STEP * (runs[:, -1:] - runs[:, :1]).mean() / (runs.shape[1] - 1)
    separate = bool(np.any((gaps <= 0) | (gaps > pause)))
    segments = runs if separate else runs.reshape(1, -1)
    clocks = [
        SampleClock.of(stamps, where=table.where, first_row=table.row(i * segments.shape[1]))
        for i, stamps in enumerate(segments)
    ]
    steps = np.array([clock.dt for clock in clocks])
    if np.ptp(steps) * (segments.shape[1] - 1) > steps.mean():
        i = int(np.argmax(np.abs(steps - np.median(steps))))
        what = f"the run from row {table.row(i * segments.shape[1])} on has a step of {steps[i]:.6g} s,"
        what += f" others {np.median(steps):.6g} s"
        raise table.error(what, "give runs of one sample rate")
    samples = segments.shape[1]
    return np.tile(SampleClock(start=0.0, dt=float(steps.mean())).times(samples), len(segments)), not separate


def _require_radians(table: ColumnTable, rig: Rig | None) -> None:
    limits = None if rig is None else rig.position_limits
    if rig is None or rig.arm is None or limits is None:
        return
    for j, ((low, high), unit) in enumerate(zip(limits, rig.arm.units, strict=True)):
        name = f"q{j + 1}"
        column, half = table.columns[name], (high - low) / 2
        outside = np.flatnonzero((column < low - half) | (column > high + half))
        if outside.size:
            i = int(outside[0])
            what = f"column {name} at row {table.row(i)} is {column[i]:g}, far outside the rig's"
            instead = "degrees" if unit == "rad" else "millimetres"
            remedy = f"give it in {unit}, or convert {instead} by `units` in a map, of `truewrench import` or `tw.read`"
            raise table.error(f"{what} [{low:g}, {high:g}] {unit} ({instead}?)", remedy)


def _require_unit_norm(table: ColumnTable) -> None:
    norm = np.linalg.norm([table.columns[name] for name in QUATERNION], axis=0)
    wrong = np.flatnonzero(np.abs(norm - 1) > NORM_TOLERANCE)
    if wrong.size:
        i = int(wrong[0])
        what = f"columns qx, qy, qz, qw at row {table.row(i)} have norm {norm[i]:.4g} instead of 1"
        raise table.error(what, "give unit quaternions, x y z w")
