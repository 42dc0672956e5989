"""Log reader: base class of the file formats, which register themselves."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import tempfile
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, ClassVar, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError, TruewrenchError, missing_package
from modeling.plugins import READERS, plugins

Array: TypeAlias = NDArray[np.float64]
ROS_TOPIC, TF_CHAIN = "ROS topic", "tf chain"
"""Kinds of the tables of a ROS bag."""
NO_WRENCH = "no topic of geometry_msgs/WrenchStamped"


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """Columns (n,) of one source (a file, a sheet, a topic), in its units; NaN where a cell is empty or no number.

    texts     columns of text, with the first different values of each
    called    what the source's own description calls a column, where its name is but a number in a list
    wrench_frame  the frame that the source states for its wrench, or whose pose it is by tf; None where it states none
    without_pose  why the source does not tell the pose of that frame; empty where it does, or says nothing of frames
    unread    what else the source holds that no table was made of, such as topics of other types
    notes     what the reader had to do, as (what, number of cells or rows, whether samples were changed by it)
    """

    name: str
    kind: str
    columns: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    called: Mapping[str, str] = field(default_factory=dict)
    wrench_frame: str | None = None
    without_pose: str = ""
    notes: tuple[tuple[str, int, bool], ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """The number of rows n."""
        return len(next(iter(self.columns.values()), ()))


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, numbered where empty (`column_3`) and where they occur again (`x.2`)."""
    seen: dict[str, int] = {}
    unique = []
    for place, name in enumerate(names, 1):
        base = name.strip() or f"column_{place}"
        seen[base] = seen.get(base, 0) + 1
        unique.append(base if seen[base] == 1 else f"{base}.{seen[base]}")
    return unique


HEAD_BYTES = 1 << 20
"""By which a format is recognised, and the layout of a text."""
MAGIC_BYTES = 16
"""By which a compression is recognised."""
LARGEST_BINARY = 4 << 30
"""Bytes to which a compressed binary file may grow: a larger one is refused before it fills the disk."""
COMPRESSED = {".gz": b"\x1f\x8b", ".bz2": b"BZh", ".xz": b"\xfd7zXZ\x00", ".zip": b"PK\x03\x04"}
ZIP_FORMATS = (".xlsx", ".xlsm", ".npz")
"""Formats that are zip files themselves."""
DAMAGED = (EOFError, OSError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError, NotImplementedError)


@dataclass(frozen=True)
class SourceFile:
    """A file or folder at `path`; it may be compressed by gzip, bzip2, xz or zip."""

    path: Path

    @property
    def name(self) -> str:
        """Its name without folders, for messages and tables."""
        return self.path.name

    @cached_property
    def compression(self) -> str | None:
        """The suffix of the compression that its first bytes show."""
        if self.path.is_dir() or self.path.suffix.lower() in ZIP_FORMATS:
            return None
        start = self._raw_start()
        return next((suffix for suffix, magic in COMPRESSED.items() if start.startswith(magic)), None)

    @cached_property
    def suffix(self) -> str:
        """Its suffix in lower case, without that of the compression."""
        name = Path(self.path.stem) if self.path.suffix.lower() in COMPRESSED else self.path
        return name.suffix.lower()

    @cached_property
    def head(self) -> bytes:
        """The first bytes, decompressed; none of a folder. Raises InputError when the file cannot be read."""
        if self.path.is_dir():
            return b""
        with self.opened() as stream:
            return stream.read(HEAD_BYTES)

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this file."""
        return InputError(what=what, where=str(self.path), remedy=remedy)

    @contextmanager
    def opened(self) -> Iterator[BinaryIO]:
        """The decompressed bytes; InputError when they cannot be read, or the compressed file is damaged."""
        try:
            with self._open() as stream:
                yield stream
        except DAMAGED as error:
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise self.error(f"cannot be read: {reason}", "give a log file that is whole and may be read") from None

    def _open(self) -> BinaryIO:
        if self.compression == ".zip":
            archive = zipfile.ZipFile(self.path)
            members = [m for m in archive.namelist() if not m.endswith("/") and not m.startswith("__MACOSX")]
            if len(members) != 1:
                raise self.error(f"a zip file with {len(members)} files", "unpack it, and give the files")
            return cast(BinaryIO, archive.open(members[0]))
        if self.compression == ".gz":
            return cast(BinaryIO, gzip.open(self.path))
        if self.compression == ".bz2":
            return cast(BinaryIO, bz2.open(self.path))
        return cast(BinaryIO, lzma.open(self.path)) if self.compression == ".xz" else self.path.open("rb")

    @contextmanager
    def on_disk(self) -> Iterator[Path]:
        """A path to the decompressed file: its own, or that of a temporary copy with its own suffix."""
        if self.compression is None:
            yield self.path
            return
        with self._temporary_copy() as copy:
            yield copy

    @contextmanager
    def _temporary_copy(self) -> Iterator[Path]:
        with ExitStack() as temporary:
            try:
                folder = temporary.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
                copy = Path(folder) / f"log{self.suffix}"
                with copy.open("wb") as out:
                    for block in self._blocks():
                        out.write(block)
                        if out.tell() > LARGEST_BINARY:
                            raise self.error("decompresses to more than 4 GiB", "decompress it, and give the file")
            except OSError as error:
                what = f"its decompressed copy cannot be written: {error.strerror or error}"
                raise self.error(what, "free space for temporary files, or set TMPDIR to another folder") from error
            yield copy

    def _blocks(self) -> Iterator[bytes]:
        with self.opened() as stream:
            while block := stream.read(HEAD_BYTES):
                yield block

    def require_members(self, largest: int) -> None:
        """InputError when the members of a format that is a zip file itself say that they are larger together."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                size = sum(member.file_size for member in archive.infolist())
        except DAMAGED:
            return  # the format's own library says what is wrong
        if size > largest:
            what = f"decompresses to {size / 2**30:.3g} GiB, and at most {largest / 2**30:.3g} GiB are read"
            raise self.error(what, "save the log in parts, or as CSV or Parquet")

    def _raw_start(self) -> bytes:
        try:
            with self.path.open("rb") as stream:
                return stream.read(MAGIC_BYTES)
        except OSError as error:
            reason = error.strerror or "cannot be read"
            raise self.error(reason, "give the path of a log file") from None


EPISODE = re.compile(r"episode_(?P<number>\d{1,9})(?:\.parquet)?")
"""How an episode of a LeRobot data set is called: the file of version 2; in version 3 no file has the name."""
FOLDERS_ABOVE = 3
"""From an episode's file to its data set: `data/chunk-000/`."""


def episode_of(path: Path) -> tuple[Path, int | None] | None:
    """The LeRobot data set that a path is of, and the episode's number where it says one; None of any other path."""
    match = EPISODE.fullmatch(path.name)
    folders = [*path.parents][:FOLDERS_ABOVE] if match else [path]
    folder = next((folder for folder in folders if (folder / "meta" / "info.json").is_file()), None)
    return None if folder is None else (folder, int(match["number"]) if match else None)


MAX_CELLS = 250_000_000
"""Numbers that a source may hold: two GB in memory."""
MAX_COLUMNS = 20_000
"""More than any robot writes: such a table is an image or a matrix."""
MOST_BAGS = 6
"""Bags below a folder that are named."""
REASON_LENGTH = 160
"""Characters of a library's own message that are repeated."""


class LogReader(ABC):
    """A file format of logs; a subclass registers itself, where `log_sources.py` imports its file.

    title    its name in messages and in the list of what can be read
    rank     readers are asked in ascending order of it, the first that recognises a source reads it; text, which nearly
             anything is, has 100
    without_file  whether a source may be part of a folder under a name that no file has
    repair   what to do about a file that its library cannot read
    """

    title: ClassVar[str]
    rank: ClassVar[int] = 0
    without_file: ClassVar[bool] = False
    repair: ClassVar[str] = "give a file that is whole"
    members: ClassVar[list[type[LogReader]]] = []

    def __init_subclass__(cls) -> None:
        LogReader.members.append(cls)
        LogReader.members.sort(key=lambda member: member.rank)

    @abstractmethod
    def recognises(self, source: SourceFile) -> bool:
        """Whether the source has this format, by its first bytes or its suffix."""

    @abstractmethod
    def tables(self, source: SourceFile) -> list[LogTable]:
        """The tables of the source. Any exception of a format's library becomes an InputError in `tables_of`."""


def tables_of(source: SourceFile) -> list[LogTable]:
    """The tables of a source, by the first format that recognises it; InputError in one line when none can read it."""
    plugins(READERS, _reader)  # which register themselves
    is_there = source.path.exists()
    members = [member() for member in LogReader.members if is_there or member.without_file]
    reader = next((member for member in members if _recognises(member, source)), None)
    if reader is None and not is_there:
        raise source.error("No such file or directory", "give the path of a log file")
    if reader is None:
        titles = ", ".join(member.title for member in LogReader.members)
        bags = [str(path.parent) for path in sorted(source.path.glob("*/metadata.yaml"))[:MOST_BAGS]]
        remedy = f"give one of: {titles}" if not bags else f"give the folder of a bag: {', '.join(bags)}"
        raise source.error(_strangeness(source), remedy)
    try:
        tables = [table for table in reader.tables(source) if table.columns and table.rows]
    except (TruewrenchError, KeyboardInterrupt):
        raise
    except ModuleNotFoundError as error:
        raise missing_package(error) or error from None
    except MemoryError:
        raise source.error("larger than the memory that is free", "cut the log into parts") from None
    except Exception as error:  # a library's own, of a damaged file: there is no common base class
        reason = " ".join(str(error).split())[:REASON_LENGTH].rstrip(".") or "it is damaged"
        raise source.error(f"cannot be read as {reader.title}: {reason}", reader.repair) from None
    if not tables:
        raise source.error(f"{reader.title} without samples", "give a log with rows of numbers")
    return tables


def _reader(kind: type[LogReader]) -> type[LogReader]:
    """A reader of another package; TypeError where it is none."""
    if not (isinstance(kind, type) and issubclass(kind, LogReader)):
        raise TypeError("no class of log readers")
    return kind


def _recognises(member: LogReader, source: SourceFile) -> bool:
    """Whether a reader takes the source; one of another package that fails does not."""
    if type(member).__module__.startswith(__name__.partition(".")[0]):
        return member.recognises(source)
    try:
        return member.recognises(source)
    except InputError:
        raise
    except Exception:
        return False


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
