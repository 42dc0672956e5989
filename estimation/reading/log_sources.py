"""Sources of an import: their tables, named where they have no header, joined row by row, and which are used."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import estimation.reading.data_files  # registers its readers, as the next two do
import estimation.reading.delimited_text
import estimation.reading.ros_bag  # noqa: F401
from estimation.reading.column_map import ColumnMap
from estimation.reading.column_pattern import PRESET_COLUMNS, PRESETS
from estimation.reading.column_recognition import ColumnMapping, column_mapping
from estimation.reading.log_reader import ROS_TOPIC, TF_CHAIN, Array, LogTable, SourceFile, tables_of
from estimation.reading.step_log import StepLog
from estimation.reading.time_column import EPOCH, TimeColumn, time_column
from modeling.errors import InputError, quoted

SHOWN_TEXTS, SHOWN_COLUMNS = 2, 4
"""Values of a column of text, and such columns, that a message repeats."""
NAMED = 6
"""Columns of a table, and unused topics of a source, that a message names."""


@dataclass(frozen=True)
class Source:
    """A source as given, and its tables as found there."""

    path: str
    tables: tuple[LogTable, ...]

    @property
    def names(self) -> set[str]:
        """The names of its tables."""
        return {table.name for table in self.tables}


def read_sources(sources: Sequence[Path | LogTable], log: StepLog) -> list[Source]:
    """Each source with its tables, no two of one name; what readers had to do is logged."""
    counts: Counter[str] = Counter()

    def named(table: LogTable) -> LogTable:
        counts[table.name] += 1
        occurs_again = counts[table.name] > 1
        table = replace(table, name=f"{table.name}#{counts[table.name]}") if occurs_again else table
        _log_notes(table, log)
        return table

    def tables(source: Path | LogTable) -> Sequence[LogTable]:
        return [source] if isinstance(source, LogTable) else tables_of(SourceFile(source))

    names = [source.name if isinstance(source, LogTable) else str(source) for source in sources]
    return [Source(name, tuple(map(named, tables(one)))) for name, one in zip(names, sources, strict=True)]


def _log_notes(table: LogTable, log: StepLog) -> None:
    for what, count, is_mended in table.notes:
        (log.mended if is_mended else log.taken)(what, table.name, count)
    if table.texts:
        columns = [*table.texts.items()][:SHOWN_COLUMNS]
        shown = ", ".join(f"{name} ({', '.join(map(quoted, texts[:SHOWN_TEXTS]))})" for name, texts in columns)
        log.taken(f"columns of text are not used: {shown}", table.name, len(table.texts))


def joined_tables(sources: Sequence[Source], preset: str | None, stated: ColumnMap, log: StepLog) -> list[LogTable]:
    """All tables of the sources, headerless ones named by the preset, and those of one clock joined row by row."""
    tables = [table for source in sources for table in source.tables]
    if preset is not None:
        require_preset(tables, preset)
    return joined_by_rows(with_preset_names(tables, preset, log), stated.columns.get("time"), log)


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
            shown = ", ".join(name.partition(":")[2] or name for name in idle[:NAMED])
            more = f" and {len(idle) - NAMED} more" if len(idle) > NAMED else ""
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
    mappings = {source.path: _mapping_of(source, stated, joint_names) for source in sources}
    whole = {path: alone for path, alone in mappings.items() if alone is not None}
    if len(whole) < 2:
        return
    used = {group.table.name for group in mapping.groups}
    apart = _apart([alone.wrench.table for alone in whole.values()], time_of)
    if not apart and all(source.names & used for source in sources if source.path in whole):
        return
    how = "they do not overlap in time" if apart else "only one of them would be used"
    raise InputError(
        what=f"{' and '.join(whole)} each hold a whole recording, wrench and motion, and {how}",
        where="SOURCE",
        remedy="import each by itself, then give the recordings together to `diagnose` or `fit`",
    )


def _mapping_of(source: Source, stated: ColumnMap, joint_names: Sequence[str] | None) -> ColumnMapping | None:
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
    stamps = np.array([]) if time is None else time.epoch + time.stamps[np.isfinite(time.stamps)]
    return (float(stamps.min()), float(stamps.max())) if len(stamps) else None


# Tables as they are found, named and joined.


WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
UNNAMED = re.compile(r"column_\d+")
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
WRENCH_FILE = re.compile(r"wrench|force|torque|(?:^|[^a-z])ft(?:[^a-z]|$)|load", re.IGNORECASE)


def is_headerless(table: LogTable) -> bool:
    """Whether no column has a name of its own."""
    return all(UNNAMED.fullmatch(name) for name in table.columns)


def require_preset(tables: Sequence[LogTable], preset: str) -> None:
    """InputError when no table looks as the preset says."""
    names = [name for table in tables for name in table.columns]
    if preset in PRESET_COLUMNS:
        fits = any(re.search(PRESET_COLUMNS[preset], name, re.IGNORECASE) for name in names)
    elif preset == "ros_bag":
        fits = any(table.kind in (ROS_TOPIC, TF_CHAIN) for table in tables)
    else:
        fits = any(map(is_headerless, tables))
        fits |= preset == "ros_csv" and any(name == "%time" or name.startswith("field.") for name in names)
    if not fits:
        shown = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
        what = f"the preset {preset} ({PRESETS[preset]}) does not fit: the columns are {shown}"
        raise InputError(what=what, where=tables[0].name, remedy="leave out --preset, or name the columns by --map")


def with_preset_names(tables: Sequence[LogTable], preset: str | None, log: StepLog) -> list[LogTable]:
    """The tables, headerless ones with the names that their preset, or content beyond doubt, gives the columns."""
    headerless = [table for table in tables if is_headerless(table)]
    if preset == "kinova" or (len(headerless) > 1 and len(headerless) == len(tables) and _one_is_time(headerless)):
        return [_named_by_file(table, log) if table in headerless else table for table in tables]
    return [_named_by_layout(table, preset, log) if table in headerless else table for table in tables]


def _named(table: LogTable, names: Sequence[str], log: StepLog) -> LogTable:
    log.taken(f"no header; its columns taken as {', '.join(names)}", table.name)
    return replace(table, columns=dict(zip(names, table.columns.values(), strict=True)))


def _named_by_layout(table: LogTable, preset: str | None, log: StepLog) -> LogTable:
    columns = list(table.columns.values())
    if preset == "ros_csv" or (len(columns) == 8 and _is_ros_echo(columns)):
        return _named(table, ("header.stamp.sec", "header.stamp.nanosec", *WRENCH), log) if len(columns) == 8 else table
    if preset == "xyz_quaternion_wrench":
        return _of_length(table, ("time", *POSE, *WRENCH), preset, log)
    if preset == "joints_deg_wrench":
        joints = len(columns) - 6
        return _of_length(table, (*(f"q{i + 1} (deg)" for i in range(joints)), *WRENCH), preset, log)
    return table


def _of_length(table: LogTable, names: Sequence[str], preset: str, log: StepLog) -> LogTable:
    if len(table.columns) != len(names):
        what = f"{len(table.columns)} columns, and {preset} has {len(names)}"
        raise InputError(what=what, where=table.name, remedy="name its columns (column_1, ..) in a map")
    return _named(table, names, log)


def _is_ros_echo(columns: Sequence[Array]) -> bool:
    """Seconds since 1970, nanoseconds below 1e9, and six more."""
    seconds, nanoseconds = (column[np.isfinite(column)] for column in columns[:2])
    whole = len(seconds) and bool((seconds == np.round(seconds)).all() and (nanoseconds == np.round(nanoseconds)).all())
    return bool(whole) and EPOCH[0] < seconds[0] < EPOCH[1] and bool(((nanoseconds >= 0) & (nanoseconds < 1e9)).all())


def _one_is_time(tables: Sequence[LogTable]) -> bool:
    lengths = {table.rows for table in tables}
    single = [table for table in tables if len(table.columns) == 1]
    return len(lengths) == 1 and any(time_column(table, factor=1.0) is not None for table in single)


def _named_by_file(table: LogTable, log: StepLog) -> LogTable:
    """Time alone, or wrench, or joints: by number of columns, and where it is six, by the file's name."""
    count = len(table.columns)
    if count == 1:
        return _named(table, ("time",), log)
    if count == 6 and WRENCH_FILE.search(table.name):
        return _named(table, WRENCH, log)
    if count == 7 and re.search(r"pose|tcp|cart", table.name, re.IGNORECASE):
        return _named(table, POSE, log)
    return _named(table, tuple(f"q{i + 1}" for i in range(count)), log)


def joined_by_rows(tables: Sequence[LogTable], stated_time: str | None, log: StepLog) -> list[LogTable]:
    """The tables, those without time joined row by row to the one of as many rows that has one."""
    timed = [t for t in tables if (stated_time in t.columns if stated_time else time_column(t, factor=1.0) is not None)]
    plain = [table for table in tables if table not in timed]
    joined = []
    for host in timed or plain[:1]:
        others = [table for table in plain if table is not host and table.rows == host.rows]
        plain = [table for table in plain if table not in others and table is not host]
        columns = dict(host.columns)
        for other in others:
            columns |= {name if name not in columns else f"{other.name}:{name}": c for name, c in other.columns.items()}
            log.taken(f"no time of its own, joined row by row to {host.name}", other.name, other.rows)
        joined.append(replace(host, columns=columns) if others else host)
    return [*joined, *plain]
