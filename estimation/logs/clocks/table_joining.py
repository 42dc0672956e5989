"""Joining of tables: names for headerless files whose layout a preset knows, and files that share their rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.logs.columns.column_pattern import PRESET_COLUMNS, PRESETS
from estimation.logs.columns.time_column import EPOCH, time_column
from estimation.logs.log_table import ROS_TOPIC, TF_CHAIN, Array, LogTable
from estimation.logs.step_log import StepLog
from modeling.errors import InputError

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
        shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
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
