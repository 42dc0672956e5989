"""Import of logs: sources of any format to one recording on one clock, with a report of every step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import estimation.reading.data_files  # registers its readers, as the next two do
import estimation.reading.delimited_text
import estimation.reading.ros_bag  # noqa: F401
from estimation.reading.column_map import ColumnMap
from estimation.reading.column_pattern import PRESETS, Quantity
from estimation.reading.column_recognition import ColumnGroup, ColumnMapping, column_mapping
from estimation.reading.frame_check import FrameCheck, require_plausible_speed
from estimation.reading.log_reader import Array, LogTable, SourceFile, tables_of
from estimation.reading.motion_streams import QUATERNION, SiColumns, in_sensor_axes
from estimation.reading.one_clock import (
    have_same_stamps,
    joined_by_rows,
    on_one_clock,
    require_preset,
    with_preset_names,
)
from estimation.reading.recording_check import note_columns, note_suspicious_channels
from estimation.reading.sample_mending import STAMP, Stream, mended, mended_runs
from estimation.reading.step_log import StepLog
from estimation.reading.time_column import TimeColumn, decreasing_time, time_column
from estimation.recordings.column_table import LARGEST_VALUE, ColumnTable, signal_unit
from estimation.recordings.differentiation import held_rows
from estimation.recordings.motion import MotionForm, motion_columns
from estimation.recordings.reading import MIN_POSES, recording_from_table
from estimation.recordings.reading_report import (
    ClockReading,
    IntervalHistogram,
    OffsetReading,
    PeriodReading,
    ReadingCurves,
    ReadingReport,
    ReadingStep,
    Span,
    UsedColumns,
    spans,
)
from estimation.recordings.recording import Recording
from modeling.errors import InputError, cut, quoted
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig

# Use of the sources: which of them hold a whole recording, and of which nothing is used.


MOST_NAMED = 6
"""Topics of one source that are named as unused."""


@dataclass(frozen=True)
class Source:
    """A source as given, and its tables as found there."""

    path: str
    tables: tuple[LogTable, ...]

    @property
    def names(self) -> set[str]:
        """The names of its tables."""
        return {table.name for table in self.tables}


def note_unused(sources: Sequence[Source], joined: Sequence[LogTable], mapping: ColumnMapping, log: StepLog) -> None:
    """Log each source, and each topic or sheet of a used one, of which nothing is in the recording.

    `joined` are the tables after the joining row by row: one that is no longer among them is part of another.
    """
    used = {group.table.name for group in mapping.groups}
    unused = {table.name for table in joined} - used
    for source in sources:
        idle = [table.name for table in source.tables if table.name in unused]
        if len(idle) == len(source.tables) and len(sources) > 1:
            log.suspicious("nothing of this source is used", source.path)
        elif idle:
            shown = ", ".join(name.partition(":")[2] or name for name in idle[:MOST_NAMED])
            more = f" and {len(idle) - MOST_NAMED} more" if len(idle) > MOST_NAMED else ""
            log.taken(f"not used: {shown}{more}", source.path)


def require_one_recording(
    sources: Sequence[Source],
    mapping: ColumnMapping,
    stated: ColumnMap,
    joint_names: Sequence[str] | None,
    time_of: Callable[[LogTable], TimeColumn | None],
) -> None:
    """InputError where several sources are each a whole recording, and are not parts of one.

    They are parts of one where something of each is used, at the same time.
    """
    own = {source.path: _own_mapping(source, stated, joint_names) for source in sources}
    whole = {path: found for path, found in own.items() if found is not None}
    if len(whole) < 2:
        return
    used = {group.table.name for group in mapping.groups}
    apart = _apart([found.wrench.table for found in whole.values()], time_of)
    if not apart and all(source.names & used for source in sources if source.path in whole):
        return
    how = "they do not overlap in time" if apart else "only one of them would be used"
    raise InputError(
        what=f"{' and '.join(whole)} each hold a whole recording, wrench and motion, and {how}",
        where="SOURCE",
        remedy="import each by itself, then give the recordings together to `diagnose` or `fit`",
    )


def _own_mapping(source: Source, stated: ColumnMap, joint_names: Sequence[str] | None) -> ColumnMapping | None:
    """Wrench and motion as recognised in this source alone; None where one of them is not."""
    try:
        return column_mapping(source.tables, stated, joint_names)
    except InputError:
        return None


def _apart(tables: Sequence[LogTable], time_of: Callable[[LogTable], TimeColumn | None]) -> bool:
    """Whether the spans of time of these tables have gaps between them."""
    spans = sorted(span for table in tables if (span := _span(table, time_of)) is not None)
    return any(start > end for (_, end), (start, _) in pairwise(spans))


def _span(table: LogTable, time_of: Callable[[LogTable], TimeColumn | None]) -> tuple[float, float] | None:
    """First and last stamp of a table, s; None where it has no time, or it is in doubt."""
    try:
        time = time_of(table)
    except InputError:
        return None
    known = np.array([]) if time is None else time.epoch + time.stamps[np.isfinite(time.stamps)]
    return (float(known.min()), float(known.max())) if len(known) else None


# Picture of a log's reading: the recording's curves, and when each step happened, on the recording's stamps.


MOST_DIRECTIONS = 600
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


SHARED_ROWS = 0.5
"""Share of rows in common from which two groups of columns were sampled together."""
SHARED_TABLE = 0.2
"""Share of rows without a sample, from which a table holds other topics' rows too; fewer are missing cells."""
REPEATED_WRENCH, REPEATED_MOTION = 0.02, 0.5
"""Share of rows with the values of the row before that is suspicious: noise changes a wrench in nearly every row, and a
motion may pause."""
FILLED_SHARE = 0.5
"""Of an auxiliary column's cells; emptier ones are not kept."""
SHOWN_TEXTS, SHOWN_COLUMNS = 2, 4
"""Values of a column of text, and such columns, that a message repeats."""
MOST_AUXILIARY = 40
POSE_STEP = 0.05
"""Radians between neighbouring rows without time from which they are poses at rest, and no run."""
RESERVED = {
    *PLANAR_CHANNELS,
    *SPATIAL_CHANNELS,
    "time",
    *motion_columns(MotionForm.PLANAR_POSE),
    *motion_columns(MotionForm.POSE),
}

Mask: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = NDArray[np.int64]
Groups: TypeAlias = Sequence[tuple[ColumnGroup, dict[str, Array]]]
"""Groups of columns, the wrench's first, each with what it becomes, in SI units."""
Clocks: TypeAlias = tuple[tuple[ClockReading, ...], OffsetReading | None, PeriodReading | None, float | None]


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
    sources: Sequence[str | Path], options: ReadingOptions | None = None, *, rig: Rig | None = None
) -> ImportedRecording:
    """One recording of these sources. `rig` gives [columns], and the arm that joint angles need for a clock offset.

    Raises InputError, in one line, for whatever cannot be read, or could be read in two ways.
    """
    options = options or ReadingOptions()
    if options.preset is not None and options.preset not in PRESETS:
        what = f"there is no preset {quoted(options.preset)}"
        raise InputError(what=what, where="--preset", remedy=f"use one of {', '.join(PRESETS)}")
    try:
        return _Reading([Path(source) for source in sources], options, rig).imported()
    except MemoryError:
        what = "larger than the memory that is free"
        raise InputError(what=what, where=str(sources[0]), remedy="cut the log into parts") from None


class _Reading:
    """One import, from the sources to the recording."""

    def __init__(self, paths: Sequence[Path], options: ReadingOptions, rig: Rig | None) -> None:
        self.paths, self.options, self.rig = paths, options, rig
        own = None if rig is None or rig.columns is None else ColumnMap.of(rig.columns, "[columns] of the rig")
        self.stated = options.stated or own or ColumnMap()
        self.log = StepLog(strict=options.strict)
        self.times: dict[int, TimeColumn | None] = {}
        self.one_clock = True

    def imported(self) -> ImportedRecording:
        given = self._sources()
        tables = [table for source in given for table in source.tables]
        sources = tuple((t.name, t.kind, t.rows, len(t.columns) + len(t.texts)) for t in tables)
        if self.options.preset is not None:
            require_preset(tables, self.options.preset)
        tables = with_preset_names(tables, self.options.preset, self.log)
        tables = joined_by_rows(tables, self.stated.columns.get("time"), self.log)
        arm = None if self.rig is None else self.rig.arm
        names = None if arm is None else _joint_names(self.rig, arm.joints)
        mapping = column_mapping(tables, self.stated, names)
        require_one_recording(given, mapping, self.stated, names, self._time)
        note_unused(given, tables, mapping, self.log)
        si = SiColumns(mapping, self.stated, self.log)
        groups = [(mapping.wrench, si.wrench())]
        groups += [(group, si.motion(group)) for group in mapping.groups[1:]]
        columns, report_parts = self._on_one_clock(mapping, groups, si.base_axes)
        clocks, offset, period, rate = report_parts
        stamps = columns.pop(STAMP, None)
        if mapping.joints and arm is None and rate is not None and self.stated.factor("angle") is None:
            require_plausible_speed(columns, rate, mapping.joints[0])
        wrench, samples = mapping.wrench.table.name, len(columns[mapping.wrench.targets[0]])
        if {"fz", "qw"} <= set(columns):
            is_moved = offset is not None and offset.applied
            columns = self._frame_check(mapping).checked(columns, stamps, is_moved=is_moved)
        else:
            note_columns(columns, wrench, self.rig, self.log)
        instants = np.arange(1.0, samples + 1) if stamps is None else stamps
        note_suspicious_channels({c: columns[c] for c in mapping.wrench.targets}, instants, wrench, self.log)
        curves, steps = picture_of(columns, stamps, self.log.steps, wrench, offset, self.rig)
        report = ReadingReport(
            sources=sources, used=tuple(si.used), clocks=clocks, offset=offset, period=period, steps=steps,
            samples=samples, rate=rate, columns=tuple(columns), curves=curves,
        )  # fmt: skip
        return ImportedRecording(name=self.paths[0].name, columns=columns, report=report)

    def _frame_check(self, mapping: ColumnMapping) -> FrameCheck:
        return FrameCheck(mapping, self.stated, self.log, None if self.rig is None else self.rig.gravity_direction)

    # ------------------------------------------------------------------------------------- sources

    def _sources(self) -> list[Source]:
        """Each source with its tables, of which no two have one name."""
        counts: dict[str, int] = {}
        return [
            Source(str(path), tuple(self._named(table, counts) for table in tables_of(SourceFile(path))))
            for path in self.paths
        ]

    def _named(self, table: LogTable, counts: dict[str, int]) -> LogTable:
        """The table, numbered where its name occurs again; what its reader had to do is logged."""
        counts[table.name] = counts.get(table.name, 0) + 1
        named = table if counts[table.name] == 1 else replace(table, name=f"{table.name}#{counts[table.name]}")
        for what, count, is_mended in table.notes:
            (self.log.mended if is_mended else self.log.taken)(what, named.name, count)
        if table.texts:
            columns = [*table.texts.items()][:SHOWN_COLUMNS]
            shown = ", ".join(f"{name} ({', '.join(map(quoted, texts[:SHOWN_TEXTS]))})" for name, texts in columns)
            self.log.taken(f"columns of text are not used: {shown}", named.name, len(table.texts))
        return named

    def _time(self, table: LogTable) -> TimeColumn | None:
        """The time of a table, found once."""
        if id(table) not in self.times:
            stated = self.stated.columns.get("time")
            stated = stated if stated in table.columns else None
            franka = any("o_t_ee" in name.lower() or "_ext_hat_" in name.lower() for name in table.columns)
            found = time_column(table, stated=stated, factor=self.stated.factor("time"), milliseconds=franka)
            if found is None and self.stated.rate is not None:
                stamps = np.arange(table.rows) / self.stated.rate
                found = TimeColumn(columns=(), stamps=stamps, epoch=0.0, how=f"{self.stated.rate:g} Hz, as stated")
            if found is not None:
                named = " and ".join(found.columns) or "no column"
                self.log.taken(f"time from {named}: {found.how}", table.name)
            self.times[id(table)] = found
        return self.times[id(table)]

    # --------------------------------------------------------------------------------------- clocks

    def _on_one_clock(self, mapping: ColumnMapping, groups: Groups, base_axes: bool) -> tuple[dict[str, Array], Clocks]:
        tables = list({id(group.table): group.table for group, _ in groups}.values())
        timed = [self._time(table) for table in tables]
        for table, time in zip(tables, timed, strict=True):
            falling = decreasing_time(table) if time is None else None
            if falling is not None:
                what = f"column {falling} decreases from row to row, and time increases"
                raise InputError(what=what, where=table.name, remedy="give the rows in the order of time")
        if all(time is None for time in timed):
            return self._poses(mapping, groups, base_axes), ((), None, None, None)
        for table, time in zip(tables, timed, strict=True):
            if time is None:
                what = "no time is recognised in this source, and another source has one"
                raise InputError(what=what, where=table.name, remedy='name it in a map: time = "column"')
        streams = self._streams(groups)
        mend = mended_runs if len(streams) == 1 else mended
        series = [mend(stream, self.log) for stream in streams]
        stamped = {**series[0].columns, STAMP: series[0].instants}
        series[0] = replace(series[0], columns=stamped)
        stated, options = self.stated, self.options
        offset = stated.offset if options.clock_offset is None else options.clock_offset
        clock = on_one_clock(
            series, offset, options.period, self.rig, self.log, self.one_clock, options.one_run,
            same_stamps=have_same_stamps(streams),
        )  # fmt: skip
        columns = self._turned(clock.columns, base_axes)
        intervals = [IntervalHistogram.of(stream.stamps) for stream in streams]
        clocks = tuple(replace(s.reading, intervals=own) for s, own in zip(series, intervals, strict=True))
        return columns, (clocks, clock.offset, clock.period, clock.rate)

    def _streams(self, groups: Groups) -> list[Stream]:
        """Groups that were sampled together as one stream each, with the auxiliary columns of their table."""
        streams: list[tuple[LogTable, dict[str, Array], Mask]] = []
        for group, columns in groups:
            rows = self._own_rows(group, columns, groups)
            # Rows of one table share a clock, unless each is of one topic only.
            self.one_clock &= all(table is group.table and bool((known & rows).any()) for table, _, known in streams)
            for place, (table, members, known) in enumerate(streams):
                if table is group.table and (known & rows).sum() >= SHARED_ROWS * max(known.sum(), rows.sum()):
                    streams[place] = (table, members | columns, known & rows)
                    break
            else:
                streams.append((group.table, dict(columns), rows))
        return [self._stream(*stream, groups) for stream in streams]

    def _own_rows(self, group: ColumnGroup, columns: Mapping[str, Array], groups: Groups) -> Mask:
        """Mask of the rows in which a group has a new sample: all its cells filled, and none held from before."""
        rows = np.ones(group.table.rows, dtype=bool)
        for column in columns.values():
            rows &= np.isfinite(column)
        known = np.flatnonzero(rows)
        time = self._time(group.table)
        if time is not None and len(known):  # a row that is written twice holds nothing
            known = known[np.concatenate([[True], np.diff(time.stamps[known]) != 0])]
        if len(known) < 2:
            raise InputError(
                what=f"{group.title} has no samples", where=group.table.name, remedy="give a log that has them"
            )
        changed, held = held_rows((column[known] for column in columns.values()), len(known))
        share = 1 - float(changed.mean())
        total = len(known)
        if held:
            what = f"{group.quantity.value} held for {held} rows each: only its new values are used"
            at = self._spans(group.table, known[~changed], groups)
            self.log.mended(what, group.table.name, total - int(changed.sum()), total, at, columns)
            rows = np.zeros(group.table.rows, dtype=bool)
            rows[known[changed]] = True
        elif share > (REPEATED_WRENCH if group.quantity is Quantity.WRENCH else REPEATED_MOTION):
            what, at = (
                f"{group.quantity.value} repeats its last value",
                self._spans(group.table, known[~changed], groups),
            )
            self.log.suspicious(what, group.table.name, total - int(changed.sum()), total, at, columns)
        return rows

    def _stamps(self, table: LogTable, groups: Groups) -> Array:
        """Stamps (n,) of a table's rows, s since the epoch of all."""
        time = self._time(table)
        assert time is not None  # checked before
        return time.stamps + (time.epoch - self._epoch(groups))

    def _spans(self, table: LogTable, rows: Index, groups: Groups) -> tuple[Span, ...]:
        return spans(self._stamps(table, groups), rows)

    def _stream(self, table: LogTable, columns: Mapping[str, Array], rows: Mask, groups: Groups) -> Stream:
        """The rows of a stream; those where it has no sample are left out, the auxiliary columns with them."""
        holder = next(set(own) for group, own in groups if group.table is table)
        full = {**columns, **(self._auxiliary(table, groups) if holder <= set(columns) else {})}
        stamps = self._stamps(table, groups)
        if not rows.all():
            kept = np.flatnonzero(rows | ~np.isfinite(stamps))
            self._note_rows(table, rows, len(kept), stamps)
            stamps, full = stamps[kept], {name: column[kept] for name, column in full.items()}
        return Stream(where=table.name, stamps=stamps, columns=full, essential=tuple(columns))

    def _note_rows(self, table: LogTable, rows: Mask, kept: int, stamps: Array) -> None:
        """Log rows in which a group has no sample, as missing cells or as those of other topics in one table."""
        without = len(rows) - kept
        if without > SHARED_TABLE * len(rows):
            self.log.taken("rows without a sample of its own", table.name, without, len(rows))
        elif without:
            what = "rows with empty or held cells left out"
            self.log.mended(what, table.name, without, len(rows), spans(stamps, ~rows))

    def _epoch(self, groups: Groups) -> float:
        """The epoch that stamps are counted from: the smallest of those since 1970, else 0."""
        epochs = [time.epoch for group, _ in groups if (time := self._time(group.table)) is not None]
        return min(epochs) if min(epochs) > 0 or max(epochs) == 0 else 0.0

    def _auxiliary(self, table: LogTable, groups: Groups) -> dict[str, Array]:
        """Columns of a table that are not used otherwise, under names that mean nothing else in a recording."""
        time = self._time(table)
        used = {name for group, _ in groups if group.table is table for name in group.columns}
        used |= set(time.columns) if time is not None else set()
        plain = all(group.columns == group.targets for group, _ in groups)
        found: dict[str, Array] = {}
        named = {column: key for key, column in self.stated.columns.items()}
        for name, column in table.columns.items():
            if name in used:
                continue
            plausible = np.abs(column) < LARGEST_VALUE
            if damaged := int((np.isfinite(column) & ~plausible).sum()):
                what = f"numbers of {cut(name)} beyond {LARGEST_VALUE:g} taken as missing"
                self.log.mended(what, table.name, damaged, len(column))
                column = np.where(plausible, column, np.nan)
            known = column[plausible]
            if len(known) < FILLED_SHARE * len(column) or not len(known) or (known[0] == known).all():
                continue
            key = named.get(name, name.replace(",", "_").replace('"', ""))
            key = "temperature" if key.lower() in ("temp", "temperature") else key
            if key == "repeat" and self.options.one_run:
                self.log.taken("column repeat is left out: one run, as stated", table.name)
                continue
            found[key if plain or key not in RESERVED or name in named else f"log_{key}"] = column
        if len(found) > MOST_AUXILIARY:
            kept = {n: c for n, c in found.items() if n in self.stated.columns or n in ("temperature", "repeat")}
            self.log.taken(
                "further columns are not kept: more than a recording needs", table.name, len(found) - len(kept)
            )
            return kept
        return found

    # ---------------------------------------------------------------------------------------- poses

    def _poses(self, mapping: ColumnMapping, groups: Groups, base_axes: bool) -> dict[str, Array]:
        """Rows without time as poses at rest; InputError when they look like a run."""
        table = mapping.wrench.table
        if any(group.table is not table for group, _ in groups):
            what = "no time is recognised in the sources"
            raise InputError(
                what=what, where=table.name, remedy='name it in a map: time = "column", or rate = 500 (Hz)'
            )
        columns = {name: column for _, part in groups for name, column in part.items()}
        complete = np.asarray(np.isfinite(np.stack(list(columns.values()))).all(axis=0))
        if not complete.all():
            self.log.mended("rows with empty cells left out", table.name, int((~complete).sum()), len(complete))
        columns = {name: column[complete] for name, column in columns.items()}
        angles = [columns[name] for name in columns if name in QUATERNION or name == "phi" or name[0] == "q"]
        step = (
            float(np.median(np.linalg.norm(np.diff(np.stack(angles), axis=1), axis=0))) if complete.sum() > 1 else 0.0
        )
        if 2 * step < POSE_STEP:
            what = f"no time, and neighbouring rows differ by {2 * step:.2g} rad:"
            what += " a run without its time, not poses at rest"
            raise InputError(
                what=what, where=table.name, remedy='state its rate in a map: rate = 500 (Hz), or time = "column"'
            )
        self.log.taken("no time: every row is a pose at rest", table.name, int(complete.sum()))
        return self._turned(columns, base_axes)

    def _turned(self, columns: Mapping[str, Array], base_axes: bool) -> dict[str, Array]:
        if not base_axes:
            return dict(columns)
        if "qx" not in columns or "fz" not in columns:
            what = "a wrench along the base's axes needs the orientation of the sensor"
            raise InputError(what=what, where=self.paths[0].name, remedy="give a log with the pose")
        return dict(columns) | in_sensor_axes(columns, columns)


def _joint_names(rig: Rig | None, joints: int) -> list[str]:
    arm = None if rig is None else rig.spatial_arm
    return [joint.name for joint in arm.chain] if arm is not None else [f"q{i + 1}" for i in range(joints)]
