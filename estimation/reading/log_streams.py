"""Streams of an import: groups of columns that were sampled together, with stamps of one epoch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.reading.column_map import ColumnMap
from estimation.reading.column_pattern import Quantity
from estimation.reading.column_recognition import ColumnGroup
from estimation.reading.log_reader import Array, LogTable
from estimation.reading.sample_mending import Index, Stream
from estimation.reading.step_log import StepLog
from estimation.reading.time_column import TableTimes
from estimation.recordings.column_table import LARGEST_VALUE
from estimation.recordings.differentiation import TrueSamples, held_rows
from estimation.recordings.motion import CLOCK_OFFSET, MotionForm, motion_columns
from estimation.recordings.reading_report import Span, spans
from modeling.errors import InputError, cut
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS

SHARED_ROWS = 0.5
"""Share of rows in common from which two groups of columns were sampled together."""
SHARED_TABLE = 0.2
"""Share of rows without a sample, from which a table holds other topics' rows too; fewer are missing cells."""
REPEATED_WRENCH, REPEATED_MOTION = 0.02, 0.5
"""Share of rows with the values of the row before that is suspicious: noise changes a wrench in nearly every row, and a
motion may pause."""
FILLED_SHARE = 0.5
"""Of an auxiliary column's cells; emptier ones are not kept."""
MOST_AUXILIARY = 40
"""Further columns that a recording keeps; of a log with more, as of a robot's whole state, only those with a name."""
RESERVED = {
    *PLANAR_CHANNELS,
    *SPATIAL_CHANNELS,
    "time",
    *motion_columns(MotionForm.PLANAR_POSE),
    *motion_columns(MotionForm.POSE),
}

Mask: TypeAlias = NDArray[np.bool_]
Groups: TypeAlias = Sequence[tuple[ColumnGroup, dict[str, Array]]]
"""Groups of columns, the wrench's first, each with what it becomes, in SI units."""


class LogStreams:
    """The streams of a log's groups, and whether their stamps are of one clock.

    With `one_run` a column that counts repeats is left out.
    """

    def __init__(self, groups: Groups, times: TableTimes, stated: ColumnMap, log: StepLog, *, one_run: bool) -> None:
        self.groups, self.times, self.stated, self.log, self.one_run = groups, times, stated, log, one_run
        self.epoch = times.epoch([group.table for group, _ in groups])
        self.one_clock = True
        self.late: dict[int, Array] = {}
        self.streams = self._together()
        if Quantity.WRENCH.value not in log.held:  # a motion alone is often logged more slowly, and no wonder
            log.held.clear()

    def _together(self) -> list[Stream]:
        """Groups that were sampled together as one stream each, with the auxiliary columns of their table."""
        streams: list[tuple[LogTable, dict[str, Array], Mask]] = []
        for group, columns in self.groups:
            rows = self._own_rows(group, columns)
            # Rows of one table share a clock, unless each is of one topic only.
            self.one_clock &= all(
                table is group.table and bool((sampled & rows).any()) for table, _, sampled in streams
            )
            for place, (table, members, sampled) in enumerate(streams):
                if table is group.table and (sampled & rows).sum() >= SHARED_ROWS * max(sampled.sum(), rows.sum()):
                    streams[place] = (table, members | columns, sampled & rows)
                    break
            else:
                streams.append((group.table, dict(columns), rows))
        return [self._stream(*stream) for stream in streams]

    def _own_rows(self, group: ColumnGroup, columns: Mapping[str, Array]) -> Mask:
        """Mask of the rows in which a group has a new sample: all its cells filled, and none held from before."""
        rows = np.ones(group.table.rows, dtype=bool)
        for column in columns.values():
            rows &= np.isfinite(column)
        complete = np.flatnonzero(rows)
        time = self.times.of(group.table)
        if time is not None and len(complete):  # a row that is written twice holds nothing
            complete = complete[np.concatenate([[True], np.diff(time.stamps[complete]) != 0])]
        if len(complete) < 2:
            raise InputError(
                what=f"{group.title} has no samples", where=group.table.name, remedy="give a log that has them"
            )
        changed, held = held_rows((column[complete] for column in columns.values()), len(complete))
        self._note_late(group.table, columns, complete)
        share = 1 - float(changed.mean())
        total = len(complete)
        if held:
            self.log.held[group.quantity.value] = held
            what = f"{group.quantity.value} held for {held} rows each: only its new values are used"
            at = self._spans(group.table, complete[~changed])
            self.log.mended(what, group.table.name, total - int(changed.sum()), total, at, columns)
            rows = np.zeros(group.table.rows, dtype=bool)
            rows[complete[changed]] = True
        elif share > (REPEATED_WRENCH if group.quantity is Quantity.WRENCH else REPEATED_MOTION):
            what, at = (
                f"{group.quantity.value} repeats its last value",
                self._spans(group.table, complete[~changed]),
            )
            self.log.suspicious(what, group.table.name, total - int(changed.sum()), total, at, columns)
        return rows

    def _note_late(self, table: LogTable, columns: Mapping[str, Array], complete: Index) -> None:
        """Keep by how many rows each new value of held columns is older than its row; a row has the latest one."""
        true = TrueSamples.of((column[complete] for column in columns.values()), 1.0, len(complete))
        if true is not None:
            late = np.zeros(table.rows)
            late[complete[true.rows]] = true.rows - true.instants
            self.late |= {id(column): late for column in columns.values()}

    @property
    def polled(self) -> float | None:
        """Step of the rows, s, of which wrench and motion were polled each when it had new values; None if not so."""
        if not self.log.held or len(self.streams) < 2 or not self.one_clock:
            return None
        steps = np.diff(self._stamps(self.groups[0][0].table))
        return float(np.median(steps[steps > 0]))

    def _stamps(self, table: LogTable) -> Array:
        """Stamps (n,) of a table's rows, s since the epoch of all."""
        time = self.times.of(table)
        assert time is not None  # checked before
        return time.stamps + (time.epoch - self.epoch)

    def _spans(self, table: LogTable, rows: Index) -> tuple[Span, ...]:
        return spans(self._stamps(table), rows)

    def _stream(self, table: LogTable, columns: Mapping[str, Array], rows: Mask) -> Stream:
        """The rows of a stream; those where it has no sample are left out, the auxiliary columns with them."""
        holder = next(set(columns_of) for group, columns_of in self.groups if group.table is table)
        full = {**columns, **(self._auxiliary(table) if holder <= set(columns) else {})}
        stamps = self._stamps(table)
        late = self.late.get(id(next(iter(columns.values()))))
        if late is not None:
            stamps = stamps - late * float(np.nanmedian(np.diff(stamps)))
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

    def _auxiliary(self, table: LogTable) -> dict[str, Array]:
        """Columns of a table that are not used otherwise, under names that mean nothing else in a recording."""
        time = self.times.of(table)
        used = {name for group, _ in self.groups if group.table is table for name in group.columns}
        used |= set(time.columns) if time is not None else set()
        plain = all(group.columns == group.targets for group, _ in self.groups)
        auxiliary: dict[str, Array] = {}
        named = {column: key for key, column in self.stated.columns.items()}
        for name, column in table.columns.items():
            if name in used:
                continue
            plausible = np.abs(column) < LARGEST_VALUE
            if damaged := int((np.isfinite(column) & ~plausible).sum()):
                what = f"numbers of {cut(name)} beyond {LARGEST_VALUE:g} taken as missing"
                self.log.mended(what, table.name, damaged, len(column))
                column = np.where(plausible, column, np.nan)
            sound = column[plausible]
            is_constant = name != CLOCK_OFFSET and bool((sound[:1] == sound).all())
            if len(sound) < FILLED_SHARE * len(column) or not len(sound) or is_constant:
                continue
            key = named.get(name, name.replace(",", "_").replace('"', ""))
            key = "temperature" if key.lower() in ("temp", "temperature") else key
            if key == "repeat" and self.one_run:
                self.log.taken("column repeat is left out: one run, as stated", table.name)
                continue
            is_free = key not in RESERVED or name in named or (plain and key != "time")
            auxiliary[key if is_free else f"log_{key}"] = column
        if len(auxiliary) > MOST_AUXILIARY:
            kept = {n: c for n, c in auxiliary.items() if n in self.stated.columns or n in ("temperature", "repeat")}
            self.log.taken(
                "further columns are not kept: more than a recording needs", table.name, len(auxiliary) - len(kept)
            )
            return kept
        return auxiliary
