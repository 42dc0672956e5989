"""Use of the sources: which of them hold a whole recording, and of which nothing is used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.logs.columns.column_map import ColumnMap
from estimation.logs.columns.column_recognition import ColumnMapping, column_mapping
from estimation.logs.columns.time_column import TimeColumn
from estimation.logs.log_table import LogTable
from estimation.logs.step_log import StepLog
from modeling.errors import InputError

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
