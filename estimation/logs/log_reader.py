"""Log reader: base class of the file formats, which register themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from estimation.logs.log_table import LogTable
from estimation.logs.source_file import SourceFile
from modeling.errors import InputError, TruewrenchError

MAX_CELLS = 250_000_000
"""Numbers that a source may hold: two GB in memory."""
MAX_COLUMNS = 20_000
MOST_BAGS = 6
"""Bags below a folder that are named."""


class LogReader(ABC):
    """A file format. Its subclasses, in `estimation/logs/readers`, are tried on a source in the order of `rank`."""

    title: ClassVar[str]
    rank: ClassVar[int] = 0
    repair: ClassVar[str] = "give a file that is whole"
    members: ClassVar[list[type[LogReader]]] = []

    def __init_subclass__(cls) -> None:
        LogReader.members.append(cls)
        LogReader.members.sort(key=lambda member: member.rank)

    @abstractmethod
    def recognises(self, source: SourceFile) -> bool:
        """Whether the source has this format, by its first bytes."""

    @abstractmethod
    def tables(self, source: SourceFile) -> list[LogTable]:
        """The tables of the source. Any exception of a format's library becomes an InputError in `tables_of`."""


def tables_of(source: SourceFile) -> list[LogTable]:
    """The tables of a source, by the first format that recognises it; InputError in one line when none can read it."""
    if not source.path.exists():
        raise source.error("No such file or directory", "give the path of a log file")
    reader = next((member() for member in LogReader.members if member().recognises(source)), None)
    if reader is None:
        titles = ", ".join(member.title for member in LogReader.members)
        bags = [str(path.parent) for path in sorted(source.path.glob("*/metadata.yaml"))[:MOST_BAGS]]
        remedy = f"give one of: {titles}" if not bags else f"give the folder of a bag: {', '.join(bags)}"
        raise source.error(_strangeness(source), remedy)
    try:
        found = [table for table in reader.tables(source) if table.columns and table.rows]
    except (TruewrenchError, KeyboardInterrupt):
        raise
    except MemoryError:
        raise source.error("larger than the memory that is free", "cut the log into parts") from None
    except Exception as error:  # a library's own, of a damaged file: there is no common base class
        reason = " ".join(str(error).split())[:160].rstrip(".") or "it is damaged"
        raise source.error(f"cannot be read as {reader.title}: {reason}", reader.repair) from None
    if not found:
        raise source.error(f"{reader.title} without samples", "give a log with rows of numbers")
    return found


def _strangeness(source: SourceFile) -> str:
    if source.path.is_dir():
        return "a folder without a ROS 2 bag"
    if not source.head.strip():
        return "the file is empty"
    if source.head[:1] == b"\x80" and source.head[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05"):
        return "a Python pickle, which can run programs and is never opened"
    if source.head.startswith(b"\xd0\xcf\x11\xe0"):
        return "an old Excel file (.xls)"
    return "a binary file of an unknown format"


def require_size(cells: int, where: str) -> None:
    """InputError when a table would have more numbers than the memory is meant for."""
    if cells > MAX_CELLS:
        what = f"{cells:.3g} numbers, and at most {MAX_CELLS:.3g} are read at once"
        raise InputError(what=what, where=where, remedy="cut the log, or keep only the columns that are needed")


def require_columns(columns: int, where: str) -> None:
    """InputError when a table has more columns than any robot writes."""
    if columns > MAX_COLUMNS:
        what = f"{columns} columns, and at most {MAX_COLUMNS} are read"
        raise InputError(what=what, where=where, remedy="give a log with the columns that are needed")
