"""Import of logs: sources of any format to one recording on one clock, with a report of every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.reading.column_map import ColumnMap, name_and_unit
from estimation.reading.column_pattern import PRESETS
from estimation.reading.column_recognition import ColumnMapping, column_mapping
from estimation.reading.frame_check import FrameCheck, require_plausible_speed
from estimation.reading.gravity_vector import ACCELERATION, RATES, checked_rates
from estimation.reading.log_reader import Array, LogTable
from estimation.reading.log_sources import joined_tables, note_unused, read_sources, require_one_recording
from estimation.reading.log_streams import Groups, LogStreams
from estimation.reading.motion_streams import SiColumns, in_sensor_axes
from estimation.reading.one_clock import HELD, have_same_stamps, on_one_clock
from estimation.reading.recording_check import note_columns, note_suspicious_channels
from estimation.reading.sample_mending import STAMP, Stream, mended, mended_runs
from estimation.reading.step_log import StepLog
from estimation.reading.time_column import TableTimes
from estimation.recordings.column_table import ColumnTable, signal_unit
from estimation.recordings.differentiation import spline_derivatives
from estimation.recordings.motion import CLOCK_OFFSET, MIN_POSES, QUATERNION, MotionForm
from estimation.recordings.motion_period import FEWEST_SAMPLES
from estimation.recordings.reading import LONGEST_FILL, dwells_between_gaps, missing_samples, recording_from_table
from estimation.recordings.reading_report import (
    Assumption,
    ClockReading,
    IntervalHistogram,
    OffsetReading,
    PeriodReading,
    ReadingCurves,
    ReadingReport,
    ReadingStep,
    UsedColumns,
)  # fmt: skip
from estimation.recordings.recording import Recording
from modeling.errors import InputError, quoted
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig

if TYPE_CHECKING:
    from estimation.recordings.dwells import Dwells

POSE_STEP = 0.05
"""Radians between neighbouring rows without time from which they are poses at rest, and no run."""


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """How to read: a preset's name, a map, the period of the motion (s), and whether mending is refused.

    With `one_run`, no period is looked for, and a column that counts repeats is left out. `clock_offset`: stamp of the
    wrench minus that of the motion at one instant, s; None to estimate it.
    """

    preset: str | None = None
    stated: ColumnMap | None = None
    period: float | None = None
    strict: bool = False
    one_run: bool = False
    clock_offset: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedRecording:
    """Columns (n,) of FORMATS' recording, and the report of how they were read."""

    name: str
    columns: Mapping[str, Array]
    report: ReadingReport

    def recording(self, rig: Rig | None = None) -> Recording:
        """The recording, with its reading report. InputError where it cannot be one."""
        table = ColumnTable(columns=self.columns, where=self.name, first_row=1)
        return replace(recording_from_table(table, name=self.name, rig=rig), reading=self.report)


def import_recording(
    sources: Sequence[str | Path | LogTable], options: ReadingOptions | None = None, *, rig: Rig | None = None
) -> ImportedRecording:
    """One recording of these sources, files or tables in memory.

    `rig` gives [columns], and the arm that joint angles need for a clock offset.

    Raises InputError, in one line, for whatever cannot be read, or could be read in two ways.
    """
    options = options or ReadingOptions()
    if options.preset is not None and options.preset not in PRESETS:
        what = f"there is no preset {quoted(options.preset)}"
        raise InputError(what=what, where="--preset", remedy=f"use one of {', '.join(PRESETS)}")
    try:
        return _imported([s if isinstance(s, LogTable) else Path(s) for s in sources], options, rig)
    except MemoryError:
        what = "larger than the memory that is free"
        raise InputError(
            what=what, where=str(getattr(sources[0], "name", sources[0])), remedy="cut the log into parts"
        ) from None


def _imported(paths: Sequence[Path | LogTable], options: ReadingOptions, rig: Rig | None) -> ImportedRecording:
    """One import, from the sources to the recording: every step of it."""
    log, stated = StepLog(strict=options.strict), _column_map(options, rig)
    sources = read_sources(paths, log)
    tables = joined_tables(sources, options.preset, stated, log)
    times, joint_names = TableTimes(stated, log), _joint_names(rig)
    mapping = column_mapping(tables, stated, joint_names)
    require_one_recording(sources, mapping, stated, joint_names, times.of)
    note_unused(sources, tables, mapping, log)
    si = SiColumns(mapping, stated, log)
    groups = [(mapping.wrench, si.wrench()), *((group, si.motion(group)) for group in mapping.groups[1:])]
    if times.are_known(list({id(group.table): group.table for group, _ in groups}.values())):
        clocked = _on_one_clock(groups, times, stated, options, rig, log)
    else:
        clocked = _poses(groups, log)
    columns = _turned(clocked.columns, paths[0].name) if si.base_axes else clocked.columns
    checked = _checked(columns, clocked, mapping, stated, rig, log)
    kept = {name: held for name, held in clocked.held.items() if checked[name] is columns[name]}
    columns = checked | kept
    curves, steps = picture_of(columns, clocked.stamps, log.steps, mapping.wrench.table.name, clocked.offset, rig)
    if clocked.offset is not None and clocked.offset.is_estimated:  # it goes with the recording
        columns = columns | {CLOCK_OFFSET: np.full(clocked.samples, clocked.offset.offset)}
    read = [table for source in sources for table in source.tables]
    report = ReadingReport(
        sources=tuple((table.name, table.kind, table.rows, len(table.columns) + len(table.texts)) for table in read),
        used=tuple(si.used), clocks=clocked.clocks, offset=clocked.offset, period=clocked.period, steps=steps,
        samples=clocked.samples, rate=clocked.rate, columns=tuple(columns), held=log.held,
        assumptions=tuple(log.assumptions), euler=_euler(mapping), curves=curves,
    )  # fmt: skip
    return ImportedRecording(name=paths[0].name, columns=columns, report=report)


def _euler(mapping: ColumnMapping) -> str:
    """The convention of Euler angles; empty for any other orientation."""
    group = mapping.orientation
    return "" if group is None or group.form is None else group.form.angles


def _column_map(options: ReadingOptions, rig: Rig | None) -> ColumnMap:
    """What is stated of the columns: the map, else [columns] of the rig."""
    if options.stated is not None:
        return options.stated
    return ColumnMap() if rig is None or rig.columns is None else ColumnMap.of(rig.columns, "[columns] of the rig")


def _joint_names(rig: Rig | None) -> list[str] | None:
    if rig is None or rig.arm is None:
        return None
    arm = rig.spatial_arm
    return [joint.name for joint in arm.chain] if arm is not None else [f"q{i + 1}" for i in range(rig.arm.joints)]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Clocked:
    """Columns (n,) of samples on one clock, and how they came there; poses at rest have neither stamps nor a rate.

    `held` are columns of a slower motion without interpolation, of which a recording rebuilds it.
    """

    columns: dict[str, Array]
    stamps: Array | None = None
    clocks: tuple[ClockReading, ...] = ()
    offset: OffsetReading | None = None
    period: PeriodReading | None = None
    rate: float | None = None
    held: Mapping[str, Array] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Their number n."""
        return len(next(iter(self.columns.values())))


def _on_one_clock(
    groups: Groups, times: TableTimes, stated: ColumnMap, options: ReadingOptions, rig: Rig | None, log: StepLog
) -> _Clocked:
    """Streams of samples, each mended on its own clock, on that of the wrench, cut into repeats."""
    logged = LogStreams(groups, times, stated, log, one_run=options.one_run)
    mend = mended_runs if len(logged.streams) == 1 else mended
    poses = len(logged.streams) == 1 and _are_poses_between_gaps(logged.streams[0], log)
    mend = partial(mended, with_gaps=True) if poses else mend
    series = [mend(stream, log) for stream in logged.streams]
    series[0] = replace(series[0], columns={STAMP: series[0].instants, **series[0].columns})
    common = on_one_clock(
        series, stated.offset if options.clock_offset is None else options.clock_offset, options.period, rig, log,
        logged.one_clock, options.one_run or poses, same_stamps=have_same_stamps(logged.streams), polled=logged.polled,
        hold=not groups[0][0].base_axes and stated.axes != "base",
    )  # fmt: skip
    columns = dict(common.columns)
    stamps = columns.pop(STAMP)
    held = {name.removeprefix(HELD): columns.pop(name) for name in [*columns] if name.startswith(HELD)}
    if poses:
        columns["time"] = stamps - stamps[0]
    clocks = tuple(
        replace(one.reading, intervals=IntervalHistogram.of(stream.stamps))
        for one, stream in zip(series, logged.streams, strict=True)
    )
    return _Clocked(
        columns=columns, stamps=stamps, clocks=clocks, offset=common.offset, period=common.period, rate=common.rate,
        held=held,
    )  # fmt: skip


def _are_poses_between_gaps(stream: Stream, log: StepLog) -> bool:
    """Whether a log with gaps in time is of poses at rest: then all of it is kept, and its rows are no run."""
    rows = np.flatnonzero(np.isfinite(stream.stamps))
    stamps, first = np.unique(stream.stamps[rows], return_index=True)
    if len(stamps) < FEWEST_SAMPLES or all(lost <= LONGEST_FILL for _, lost in missing_samples(stamps)):
        return False
    dwells = _dwells({name: column[rows[first]] for name, column in stream.columns.items()}, stamps)
    if dwells is not None:
        log.taken(f"{dwells.counted}: a log of poses, and no run", stream.where)
    return dwells is not None


def _dwells(columns: Mapping[str, Array], stamps: Array) -> Dwells | None:
    """The dwells of a log of poses (n,), in which there are no transitions, or too few rows of them."""
    forms = {"qw": MotionForm.POSE, "q1": MotionForm.JOINTS, "phi": MotionForm.PLANAR_POSE}
    form = next((form for name, form in forms.items() if name in columns), None)
    channels = PLANAR_CHANNELS if "tau" in columns else SPATIAL_CHANNELS
    if form is None or not set(channels) <= set(columns):
        return None
    dwells = dwells_between_gaps(columns, form, channels, stamps)
    return None if dwells is None or dwells.are_sampled_between else dwells


def _poses(groups: Groups, log: StepLog) -> _Clocked:
    """Rows without time as poses at rest; InputError when they look like a run."""
    table = groups[0][0].table
    if any(group.table is not table for group, _ in groups):
        remedy = 'name it in a map: time = "column", or rate = 500 (Hz)'
        raise InputError(what="no time is recognised in the sources", where=table.name, remedy=remedy)
    columns = {name: column for _, members in groups for name, column in members.items()}
    columns = {name: column for name, column in columns.items() if name not in (*RATES, *ACCELERATION)}  # at rest
    complete = np.asarray(np.isfinite(np.stack(list(columns.values()))).all(axis=0))
    if not complete.all():
        log.mended("rows with empty cells left out", table.name, int((~complete).sum()), len(complete))
    columns = {name: column[complete] for name, column in columns.items()}
    angles = np.stack([columns[name] for name in columns if name in QUATERNION or name == "phi" or name[0] == "q"])
    step = float(np.median(np.linalg.norm(np.diff(angles, axis=1), axis=0))) if complete.sum() > 1 else 0.0
    if 2 * step < POSE_STEP:
        what = f"no time, and neighbouring rows differ by {2 * step:.2g} rad: a run without its time, not poses at rest"
        remedy = 'state its rate in a map: rate = 500 (Hz), or time = "column"'
        raise InputError(what=what, where=table.name, remedy=remedy)
    log.taken("no time: every row is a pose at rest", table.name, int(complete.sum()))
    return _Clocked(columns=columns)


def _turned(columns: dict[str, Array], name: str) -> dict[str, Array]:
    """The columns with the wrench, which is along the base's axes, along the sensor's."""
    if "qx" not in columns or "fz" not in columns:
        what = "a wrench along the base's axes needs the orientation of the sensor"
        raise InputError(what=what, where=name, remedy="give a log with the pose")
    return columns | in_sensor_axes(columns, columns)


def _checked(
    columns: dict[str, Array],
    clocked: _Clocked,
    mapping: ColumnMapping,
    stated: ColumnMap,
    rig: Rig | None,
    log: StepLog,
) -> dict[str, Array]:
    """The columns in the reading that the weight shows; what is suspicious is logged, what is in doubt asked for."""
    wrench = mapping.wrench.table.name
    has_arm = rig is not None and rig.arm is not None
    if mapping.joints and not has_arm and clocked.rate is not None and stated.factor("angle") is None:
        require_plausible_speed(columns, clocked.rate, mapping.joints[0])
    if mapping.is_level:
        if clocked.rate is not None:
            columns = _with_rates(columns, mapping, stated, log)
    elif {"fz", "qw"} <= set(columns):
        check = FrameCheck(mapping, stated, log, None if rig is None else rig.gravity_direction)
        is_moved = clocked.offset is not None and clocked.offset.applied
        dwells = None if clocked.stamps is None else _dwells(columns, clocked.stamps)
        # Rows of poses have no accelerations, nor do most of them agree against a contact.
        rows = {name: column for name, column in columns.items() if dwells is None or name != "time"}
        columns = columns | check.checked(rows, clocked.stamps if dwells is None else None, is_moved=is_moved)
    else:
        note_columns(columns, wrench, rig, log)
    instants = np.arange(1.0, clocked.samples + 1) if clocked.stamps is None else clocked.stamps
    note_suspicious_channels({c: columns[c] for c in mapping.wrench.targets}, instants, wrench, log)
    return columns


def _with_rates(columns: dict[str, Array], mapping: ColumnMapping, stated: ColumnMap, log: StepLog) -> dict[str, Array]:
    """The columns of a motion without a pose, its angular velocity in rad/s; what is not known of it is logged."""
    assert mapping.orientation is not None  # it is gravity, or an accelerometer
    where, rate = mapping.orientation.table.name, mapping.rate
    is_stated = stated.factor("rate") is not None or (
        rate is not None and name_and_unit(rate.columns[0])[1] is not None
    )
    columns, in_degrees = checked_rates(columns, where, stated=is_stated)
    if "apz" in columns:  # the orientation is smoothed where it is differentiated, an acceleration that is given is not
        dt = float(columns["time"][1] - columns["time"][0])
        columns = columns | {"apz": spline_derivatives(columns["apz"][:, None], dt).value[:, 0]}
    if rate is None:
        what = "no gyroscope: what turns about the vertical is taken as at rest, as it may be in a slow motion"
        log.suspicious(what, where)
    elif in_degrees:
        log.mended("the angular velocity is in degrees per second", where)
        log.assumptions.append(Assumption("rate", "deg/s", "gravity's direction in the sensor turns by so much less"))
    return columns


# Picture of a log's reading: the recording's curves, and when each step happened, on the recording's stamps.


MOST_DIRECTIONS = 600
"""Of gravity in the picture: as many points cover a sphere."""
OTHER_UNITS = {**dict.fromkeys(("fx", "fy", "fz"), "N"), **dict.fromkeys(("tau", "tx", "ty", "tz"), "N m")}
OTHER_UNITS |= {**dict.fromkeys(("qx", "qy", "qz", "qw"), ""), "temperature": "°C"}


def picture_of(
    columns: Mapping[str, Array],
    stamps: Array | None,
    steps: Sequence[ReadingStep],
    wrench: str,
    offset: OffsetReading | None,
    rig: Rig | None,
) -> tuple[ReadingCurves, tuple[ReadingStep, ...]]:
    """Curves of a recording's columns (n,), and the steps with their times, both from its first sample on.

    stamps  (n,) of the samples on the clock of the `wrench`'s source, s; None for static poses
    """
    start = 0.0 if stamps is None else float(stamps[0])
    late = offset.offset if offset is not None and offset.applied else 0.0
    origins = {step.where: start if step.where == wrench else start - late for step in steps}
    moved = tuple(
        replace(step, at=tuple((a - origins[step.where], b - origins[step.where]) for a, b in step.at))
        for step in steps
    )
    return ReadingCurves.of(columns, _units(columns, rig), stamps, gravity_directions(columns, rig)), moved


def pictured_reading(recording: Recording) -> ReadingReport:
    """The report of a recording's reading with the curves of a picture, also of one that was read as it stands."""
    if recording.reading is not None and recording.reading.curves is not None:
        return recording.reading
    columns = {str(name): column.to_numpy(dtype=np.float64) for name, column in recording.to_frame().items()}
    stamps: Array | None = columns.get("time")
    curves, _ = picture_of(columns, stamps, (), recording.name, None, recording.rig)
    motion = tuple(name for name in recording.columns if name not in recording.auxiliary)
    used = [
        UsedColumns(quantity=quantity, source=recording.name, columns=names, targets=names, how="as it stands")
        for quantity, names in (("wrench", recording.channels), ("motion", motion))
    ]
    return ReadingReport(
        sources=((recording.name, "recording", recording.samples, len(columns)),),
        used=tuple(used),
        clocks=(),
        offset=None,
        steps=() if recording.reading is None else recording.reading.steps,
        samples=recording.samples,
        rate=None if recording.dt is None else 1 / recording.dt,
        columns=tuple(columns),
        curves=curves,
    )


def _units(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, str]:
    """SI units by channel; joint coordinates are angles where no arm says otherwise."""
    arm = None if rig is None else rig.arm
    units = {name: signal_unit(name) or OTHER_UNITS.get(name, "") for name in columns}
    units |= {f"q{j}": unit for j, unit in enumerate(arm.units if arm is not None else (), 1) if f"q{j}" in units}
    return units


def gravity_directions(columns: Mapping[str, Array], rig: Rig | None) -> Array | None:
    """Directions of gravity in the sensor's axes, (k, 3) or in the plane (k, 2), of some of the rows.

    None where the orientation is not known, as of joint angles without an arm.
    """
    samples = len(next(iter(columns.values())))
    every = slice(0, samples, -(-samples // MOST_DIRECTIONS))
    poses = {name: column[every].copy() for name, column in columns.items() if name != "repeat"}
    shown = len(next(iter(poses.values())))
    if shown < MIN_POSES:
        return None
    if "time" in columns and "qw" not in columns:
        step = every.step * float(columns["time"][1] - columns["time"][0])
        poses["time"] = np.asarray(step * np.arange(shown), dtype=np.float64)
    angles = poses if "qw" in columns else _signals(poses, rig)
    if "phi" in angles:  # y up in the world, phi clockwise
        return np.stack([np.sin(angles["phi"]), -np.cos(angles["phi"])], axis=1)
    if "qw" not in angles:
        return None
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_quat(np.stack([angles[name] for name in ("qx", "qy", "qz", "qw")], axis=1))
    return np.asarray(turn.apply([0.0, 0.0, -1.0], inverse=True))


def _signals(columns: Mapping[str, Array], rig: Rig | None) -> Mapping[str, Array]:
    """Signals (k,) of a recording of these columns; none where they are no recording."""
    table = ColumnTable(columns=columns, where="poses", first_row=1)
    try:
        return recording_from_table(table, name="poses", rig=rig).signals
    except InputError:
        return {}
