"""Time column: the stamps of a table in seconds, their unit recognised where it is beyond doubt."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.reading.column_map import TIME, ColumnMap, name_and_unit
from estimation.reading.column_pattern import NANOSECONDS, SECONDS, TIME_NAMES
from estimation.reading.log_reader import Array, LogTable
from estimation.reading.step_log import StepLog
from estimation.recordings.column_table import LARGEST_VALUE
from estimation.recordings.reading import is_regular
from estimation.recordings.reading_report import Assumption
from modeling.errors import InputError

EPOCH = (1.0e9, 2.2e9)
"""Seconds since 1970 of the years 2001 to 2039."""
SURE_SECONDS = 0.3
"""A longest sampling interval that is surely in seconds; three times a second is slow for any robot's log."""
PLAIN_NAMES = ("time", "stamp", "_*time", "%?time", "time_?stamps?", "t")
"""Names of time alone, of which none comes before another."""
SAME_SPAN = 0.01
"""Of their length: by so much two clocks may differ in a log that both stamp."""
STRAY = 50
"""Usual steps by which a stamp is off both its neighbours, which agree with each other, from which it is damaged: no
clock jumps for one row, and stamps that are late or out of order stay nearer."""
UNIT_NAMES = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
UNITS_BY_STEP = ((1e-3, "ms", 1.5, 500.0), (1e-6, "us", 500.0, 3e5), (1e-9, "ns", 3e5, 3e8))
"""Factor and name of a unit, and the steps from which and below which it is meant: robots' logs have 2 to 2000 rows a
second, and a step of 1 counts samples."""
FEWEST_STAMPS = 3
"""Of which any order says something."""
INCREASING_SHARE, CHANGING_SHARE = 0.9, 0.2
"""Of the steps of a time: a log may have rows out of order, and stamps as coarse as five rows to a tick."""
LATEST = 10.0
"""Seconds by which a time of receipt may be later than the sensor's stamp; clocks of other epochs differ by more."""
EXACT_SECONDS = 1e6
"""Beyond which whole seconds are taken off the stamps, so that a double resolves them to 1e-10 s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeColumn:
    """Stamps (n,) in s, relative to `epoch` s, NaN where missing; the columns they came from, and how.

    `taken` where nothing but the size of the steps tells their unit.
    """

    columns: tuple[str, ...]
    stamps: Array
    epoch: float
    how: str
    taken: Assumption | None = None


class TableTimes:
    """The times of an import's tables, each found once, and logged: as a map states them, or as recognised."""

    def __init__(self, stated: ColumnMap, log: StepLog) -> None:
        self.stated, self.log = stated, log
        self.times: dict[int, TimeColumn | None] = {}

    def of(self, table: LogTable) -> TimeColumn | None:
        """The time of a table; None without one. Raises InputError when its unit is in doubt."""
        if id(table) not in self.times:
            self.times[id(table)] = self._time(table)
        return self.times[id(table)]

    def _time(self, table: LogTable) -> TimeColumn | None:
        stated = self.stated.columns.get("time")
        stated = stated if stated in table.columns else None
        franka = any("o_t_ee" in name.lower() or "_ext_hat_" in name.lower() for name in table.columns)
        time = time_column(table, stated=stated, factor=self.stated.factor("time"), milliseconds=franka)
        if time is None and self.stated.rate is not None:
            stamps = np.arange(table.rows) / self.stated.rate
            time = TimeColumn(columns=(), stamps=stamps, epoch=0.0, how=f"{self.stated.rate:g} Hz, as stated")
        if time is not None and time.taken is not None:
            self.log.assumptions.append(time.taken)
        if time is not None:
            how = f"{time.how}{_other_time(table, time)}"
            self.log.taken(f"time from {' and '.join(time.columns) or 'no column'}: {how}", table.name)
        return time

    def are_known(self, tables: Sequence[LogTable]) -> bool:
        """Whether the tables have a time: all of them, or none. Raises InputError where some have, or one decreases."""
        untimed = [table for table in tables if self.of(table) is None]
        for table in untimed:
            falling = decreasing_time(table)
            if falling is not None:
                what = f"column {falling} decreases from row to row, and time increases"
                raise InputError(what=what, where=table.name, remedy="give the rows in the order of time")
        if len(untimed) == len(tables):
            return False
        for table in untimed:
            what = "no time is recognised in this source, and another source has one"
            raise InputError(what=what, where=table.name, remedy='name it in a map: time = "column"')
        return True

    def epoch(self, tables: Sequence[LogTable]) -> float:
        """The epoch that the stamps of these tables are counted from: the smallest since 1970, else 0."""
        epochs = [time.epoch for table in tables if (time := self.of(table)) is not None]
        return min(epochs) if min(epochs) > 0 or max(epochs) == 0 else 0.0


def time_column(
    table: LogTable, *, stated: str | None = None, factor: float | None = None, milliseconds: bool = False
) -> TimeColumn | None:
    """The time of a table: `stated` by a map, else by name, else by content where columns have no names; None without.

    `factor` to seconds where the unit is stated; `milliseconds` where steps of 1 mean them (presets that say so).
    Raises InputError when the unit is in doubt.
    """
    if stated is not None:
        return _one(table, stated, factor, milliseconds)
    pair = _pair(table)
    if pair is not None:
        return pair
    for name in _called_time(table):
        if _increases(table.columns[name]):
            return _undisputed(table, _one(table, name, factor, milliseconds), milliseconds)
    unnamed = [name for name in table.columns if re.fullmatch(r"column_\d+", name)]
    regular = [name for name in unnamed if _increases(table.columns[name]) and is_regular(table.columns[name])]
    if len(unnamed) == len(table.columns) and regular:
        epochs = [name for name in regular if EPOCH[0] < np.nanmedian(table.columns[name]) < EPOCH[1] * 1e9]
        return _one(table, (epochs or regular)[0], factor, milliseconds)
    return None


def _undisputed(table: LogTable, chosen: TimeColumn, milliseconds: bool) -> TimeColumn:
    """The time found by a plain name, where no other plain name tells another time. Raises InputError."""
    plain = [n for n in table.columns if any(re.fullmatch(p, name_and_unit(n)[0], re.IGNORECASE) for p in PLAIN_NAMES)]
    if not set(chosen.columns) <= set(plain):
        return chosen
    for name in plain:
        if name in chosen.columns or not (_increases(table.columns[name]) and is_regular(table.columns[name])):
            continue
        try:
            other = _one(table, name, None, milliseconds)
        except InputError:  # a count of samples
            continue
        spans = [float(np.nanmax(one.stamps) - np.nanmin(one.stamps)) for one in (chosen, other)]
        if abs(spans[0] - spans[1]) > SAME_SPAN * max(spans):
            means = [
                f"{one.columns[0]} ({span:.4g} s, {(table.rows - 1) / span:.5g} Hz)"
                for one, span in zip((chosen, other), spans, strict=True)
            ]
            raise InputError(
                what=f"the time could be {means[0]} or {means[1]}; accelerations would differ by the square of that",
                where=table.name,
                remedy=f'state it in a map: time = "{chosen.columns[0]}", or "{name}"',
            )
    return chosen


def _called_time(table: LogTable) -> Iterator[str]:
    """Columns with a name of the time, the best name first."""
    for pattern in TIME_NAMES:
        for name in table.columns:
            bare = name_and_unit(name)[0]
            if any(re.fullmatch(pattern, word, re.IGNORECASE) for word in (bare, re.split(r"[./:]", bare)[-1])):
                yield name


def _other_time(table: LogTable, chosen: TimeColumn) -> str:
    """The first other column that is called as a time, and why it is not used, for a message; empty without one."""
    stem = chosen.columns[0].rpartition(".")[0] if len(chosen.columns) > 1 else None
    for name in _called_time(table):
        if name in chosen.columns or (stem and name.startswith(stem)):
            continue
        if not _increases(table.columns[name]):
            return f"; {name} is not used, as it does not increase"
        try:
            other = _one(table, name, None, milliseconds=False)
        except InputError:  # a count of samples
            continue
        late = other.epoch - chosen.epoch + float(np.nanmedian(other.stamps - chosen.stamps))
        return f"; {name} is not used" + (f", {1e3 * late:.3g} ms later in the median" if 0 < late < LATEST else "")
    return ""


def decreasing_time(table: LogTable) -> str | None:
    """The column that is called like a time and decreases from row to row; None without one."""
    return next((name for name in _called_time(table) if _increases(-table.columns[name])), None)


def _pair(table: LogTable) -> TimeColumn | None:
    """Seconds and nanoseconds in two columns, those of a header before any other."""
    names = sorted(table.columns, key=lambda name: "header" not in name.lower())
    for name in names:
        seconds = re.fullmatch(SECONDS, name, re.IGNORECASE)
        other = seconds and next(
            (n for n in names if (m := re.fullmatch(NANOSECONDS, n, re.IGNORECASE)) and m["stem"] == seconds["stem"]),
            None,
        )
        if other:
            whole, parts = _without_strays(table.columns[name]), table.columns[other]
            epoch = float(np.floor(whole[np.isfinite(whole)][0])) if np.isfinite(whole).any() else 0.0
            return TimeColumn(columns=(name, other), stamps=(whole - epoch) + parts * 1e-9, epoch=epoch, how="s and ns")
    return None


def _increases(column: Array) -> bool:
    stamps = column[np.isfinite(column)]
    if len(stamps) < FEWEST_STAMPS:
        return False
    steps = np.diff(stamps)
    return bool((steps >= 0).mean() > INCREASING_SHARE and (steps > 0).mean() > CHANGING_SHARE)


def _without_strays(column: Array) -> Array:
    """The stamps, NaN where they are damaged: a single one that is far off, while its neighbours are not."""
    is_stamp = np.abs(column) < LARGEST_VALUE
    rows = np.flatnonzero(is_stamp)
    stamps = column[rows]
    steps = np.diff(stamps)
    if len(stamps) > 2 and steps.any():
        reach = STRAY * float(np.median(np.abs(steps[steps != 0])))
        far, agree = np.abs(steps) > reach, np.abs(stamps[2:] - stamps[:-2]) <= reach
        stray = np.concatenate([[steps[0] < -reach], far[:-1] & far[1:] & agree, [steps[-1] < -reach]])
        is_stamp[rows[stray]] = False
    return column if is_stamp.all() else np.where(is_stamp, column, np.nan)


def _one(table: LogTable, name: str, factor: float | None, milliseconds: bool) -> TimeColumn:
    column = _without_strays(table.columns[name])
    unit = name_and_unit(name)[1]
    how, taken = "as stated", None
    if factor is None and unit in TIME:
        factor, how = TIME[unit], f"{unit}, as its name says"
    if factor is None:
        factor, how = _recognised_factor(column, name, table.name, milliseconds)
        if "recognised by their step" in how:
            taken = Assumption("time", UNIT_NAMES[factor], f"its steps are {how.rpartition(' ')[2]}, unlikely in s")
    damaged = int(np.isfinite(table.columns[name]).sum() - np.isfinite(column).sum())
    how += f"; damaged stamps, {damaged}, taken as missing" if damaged else ""
    finite = column[np.isfinite(column)]
    start = float(finite[0]) if len(finite) else 0.0
    # Whole seconds are taken off before scaling, or stamps of 1e18 ns would be rounded to 0.2 µs once more.
    epoch = np.floor(start * factor) if abs(start * factor) > EXACT_SECONDS else 0.0
    stamps = column * factor if epoch == 0.0 else (column - epoch / factor) * factor
    return TimeColumn(columns=(name,), stamps=stamps, epoch=float(epoch), how=how, taken=taken)


def _recognised_factor(column: Array, name: str, where: str, milliseconds: bool) -> tuple[float, str]:
    stamps = column[np.isfinite(column)]
    if len(stamps) < 2:
        return 1.0, "s"
    middle = float(np.median(stamps))
    for factor, unit in UNIT_NAMES.items():
        if EPOCH[0] < middle * factor < EPOCH[1]:
            return factor, f"{unit} since 1970" + ("" if factor == 1.0 else ", recognised by their size")
    steps = np.diff(stamps)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    if step <= SURE_SECONDS:
        return 1.0, "s"
    for factor, unit, least, most in UNITS_BY_STEP:
        if least <= step < most or (unit == "ms" and milliseconds and step < most):
            return factor, f"{unit}, recognised by their step of {step:.6g}"
    what = f"column {name} steps by {step:.4g}: seconds, milliseconds or a count of samples?"
    raise InputError(what=what, where=where, remedy='state it in a map: units = { time = "ms" }, or rate = 500 (Hz)')
