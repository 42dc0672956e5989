"""Table of named numeric columns from CSV, Parquet, Arrow or pandas, with validation errors that name the cell."""

from __future__ import annotations

import csv
import io
import re
import shlex
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.errors import InputError, cut, missing_package

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from pyarrow import parquet as pq

Array: TypeAlias = NDArray[np.float64]

ORIENTATION_ERRORS = ("turn_x", "turn_y", "turn_z")
"""Small rotations of the sensor about its own axes, rad, in which the noise of a quaternion is stated."""

_UNITS = {
    "rad": r"q\d+|phi|turn_[xyz]",
    "rad/s": r"dq\d+|dphi|w[xyz]",
    "rad/s²": r"ddq\d+|ddphi|al[xyz]",
    "m": r"p[xyz]",
    "m/s": r"v[xy]|vp[xyz]",
    "m/s²": r"a[xy]|ap[xyz]",
}


def signal_unit(signal: str) -> str:
    """The SI unit of a motion signal, of a revolute joint where it is a joint's; empty when it is none."""
    return next((unit for unit, names in _UNITS.items() if re.fullmatch(names, signal)), "")


PLAIN_CSV_BYTES = b"0123456789+-.eE, \t\n"
"""Characters of a CSV of decimal numbers below its header; any other needs the general reader."""
PANDAS_INDEX_NAME = re.compile(r"__index_level_\d+__")
"""The name that pandas gives a Parquet file's column of row labels."""
LARGEST_VALUE = 1e20
"""Beyond whatever is measured, and beyond stamps in ns since 1970 (1.8e18); sums of squares of squares stay finite."""
OWN_NAMES = re.compile(r"f[xyz]|t[xyz]|tau|phi|q[xyzw]|q[1-9]\d*")
"""Columns of a recording's wrench or motion: a table without any is a log of another layout."""
SHOWN_NAMES = 3
"""Names of a log's columns that a message repeats."""
FILE_REMEDY = "give the path of a CSV or Parquet file"
HEADER_BYTES = 1 << 20
"""Bytes of a file that its header may have: tens of thousands of names, more than any robot writes."""
PARQUET_MAGIC = b"PAR1"
PARQUET_BUFFER = 2**18
"""Bytes of each column read from a Parquet file at once, whatever the length of its row groups."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnTable:
    """Columns (n,) by name, of finite numbers; their source, and the row of the first sample in it."""

    columns: Mapping[str, Array]
    where: str
    first_row: int

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def row(self, index: int) -> int:
        """Row in the file of a sample; a CSV's header is row 1."""
        return self.first_row + index

    def rows(self, start: int, end: int) -> ColumnTable:
        """The rows from start to end, without a copy."""
        columns = {name: values[start:end] for name, values in self.columns.items()}
        return ColumnTable(columns=columns, where=self.where, first_row=self.first_row + start)

    @staticmethod
    def joined(tables: Sequence[ColumnTable]) -> ColumnTable:
        """Consecutive tables of the same columns as one."""
        first = tables[0]
        if len(tables) == 1:
            return first
        columns = {name: np.concatenate([table.columns[name] for table in tables]) for name in first.columns}
        return ColumnTable(columns=columns, where=first.where, first_row=first.first_row)

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this table."""
        return InputError(what=what, where=self.where, remedy=remedy)


def import_remedy(where: str) -> str:
    """What to do with a log that is no recording as it stands: the command to type where `where` is its path."""
    if not Path(where).exists():
        return "bring the log in by `truewrench import`, or `tw.read` with a map"
    return (
        f"bring the log in first: `truewrench import {shlex.quote(where)} --out recording.csv`, or `tw.read` with a map"
    )


def _numeric_remedy(where: str) -> str:
    return f"make the column numeric, remove it, or {import_remedy(where)}"


class TableFile(ABC):
    """A CSV or Parquet file with the columns of a recording: its names, and its rows at once or in stretches.

    Strict where an import of logs mends and reports: a fit takes every row as it stands, so that whatever is no finite
    number, in a column that is wanted, is an error that names the cell. Text is UTF-8, with commas between the columns
    and points in the numbers, in any of the usual line ends.

    path     for messages, and of the file, which is opened again for each pass
    names    of the columns
    content  the bytes of the file where they were read already, so that a pipe can be read too
    """

    def __init__(self, path: Path, content: bytes | None, start: bytes) -> None:
        self.path, self.content = path, content
        self.names = self._names(start)

    @abstractmethod
    def _names(self, start: bytes) -> tuple[str, ...]:
        """The names of the columns, of a file with this start."""

    @abstractmethod
    def stretches(self, size: int | None = None, wanted: Sequence[str] | None = None) -> Iterator[ColumnTable]:
        """The wanted columns, by default all, in tables of `size` rows, the last one shorter; by default in one.

        Raises InputError, with the row in the file, for a value that is not a finite number.
        """

    @abstractmethod
    def rows(self) -> int:
        """About how many rows there are, without reading them; of a file alone."""

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this file."""
        return InputError(what=what, where=str(self.path), remedy=remedy)


def table_file(path: Path, content: bytes | None = None) -> TableFile:
    """The file at that path, of which only the names are read; `content` has its bytes where they are known.

    Raises InputError where it cannot be read, or its columns have not the names of a recording.
    """
    if path.is_char_device():  # /dev/zero has no end
        raise InputError(what="a device, no recording", where=str(path), remedy=FILE_REMEDY)
    try:
        with path.open("rb") if content is None else io.BytesIO(content) as stream:
            start = stream.read(HEADER_BYTES)
    except OSError as error:
        raise unreadable(path, error) from None
    if not start.strip():
        raise InputError(what="the file is empty", where=str(path), remedy="give a recording with a header row")
    return (ParquetFile if start.startswith(PARQUET_MAGIC) else CsvFile)(path, content, start)


def table_from_file(path: Path) -> ColumnTable:
    """The table in a CSV or Parquet file, which is read once; rows are counted with a CSV's header as row 1."""
    if path.is_char_device():
        return next(table_file(path).stretches())  # raises
    try:
        content = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    table = next(table_file(path, content).stretches(), None)
    if table is None or not table.columns or not len(table):
        raise InputError(what="there are no samples", where=str(path), remedy="give a recording with rows")
    return table


def unreadable(path: Path, error: OSError) -> InputError:
    """The InputError of a path that the system cannot read."""
    if path.is_dir():
        return InputError(what="a directory, no recording", where=str(path), remedy=import_remedy(str(path)))
    return InputError(what=f"cannot be read: {error.strerror or error}", where=str(path), remedy=FILE_REMEDY)


class ParquetFile(TableFile):
    """A Parquet file; rows are counted from 1."""

    def _names(self, start: bytes) -> tuple[str, ...]:
        with self._damage_refused(), parquet_file(self._source()) as file:
            names = file.schema_arrow.names
        return tuple(
            require_own_names([name for name in names if not PANDAS_INDEX_NAME.fullmatch(name)], str(self.path))
        )

    def stretches(self, size: int | None = None, wanted: Sequence[str] | None = None) -> Iterator[ColumnTable]:
        """As of any; across row groups, of whose pages few are in memory at once where a size is given."""
        columns, row = list(self.names if wanted is None else wanted), 1
        with self._damage_refused():
            if size is None:
                with parquet_file(self._source()) as file:
                    yield table_from_arrow(file.read(columns), str(self.path))
                return
            held: list[ColumnTable] = []
            with parquet_file(self._source(), pre_buffer=False, buffer_size=PARQUET_BUFFER) as file:
                for batch in file.iter_batches(batch_size=size, columns=columns, use_threads=False):
                    held.append(table_from_arrow(batch, str(self.path), row))
                    row += batch.num_rows
                    while sum(map(len, held)) >= size:
                        joined = ColumnTable.joined(held)
                        yield joined.rows(0, size)
                        held = [joined.rows(size, len(joined))] if len(joined) > size else []
            if held and sum(map(len, held)):
                yield ColumnTable.joined(held)

    def rows(self) -> int:
        """As its metadata say."""
        with self._damage_refused(), parquet_file(self._source()) as file:
            return int(file.metadata.num_rows)

    def _source(self) -> Path | BinaryIO:
        return self.path if self.content is None else io.BytesIO(self.content)

    @contextmanager
    def _damage_refused(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, arrow().ArrowException) as error:
            raise self.error(f"cannot be read as Parquet: {error}", FILE_REMEDY) from None


def parquet_file(source: BinaryIO | Path, **options: Any) -> pq.ParquetFile:
    """A Parquet file, opened; its own `read` needs no pandas, unlike `pyarrow.parquet.read_table`."""
    return arrow().parquet.ParquetFile(source, **options)


def arrow() -> Any:
    """The package PyArrow with its Parquet, which a CSV does not need; InputError where it is not installed."""
    try:
        import pyarrow.parquet  # slow to import
    except ModuleNotFoundError as error:
        raise missing_package(error) or error from None
    return pyarrow


class CsvFile(TableFile):
    """A CSV file; rows are counted with its header as row 1."""

    def _names(self, start: bytes) -> tuple[str, ...]:
        text = start.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
        if len(start) == HEADER_BYTES and "\n" not in text:
            raise self.error("row 1 is longer than 1 MB", import_remedy(str(self.path)))
        try:
            return tuple(header_names(text, str(self.path)))
        except InputError:  # the cause may be that it is no text
            first = text.partition("\n")[0]
            if "\0" in first:
                raise self._binary() from None
            if "\ufffd" in first:
                raise self._not_text() from None
            raise

    def stretches(self, size: int | None = None, wanted: Sequence[str] | None = None) -> Iterator[ColumnTable]:
        """As of any; of columns that are not wanted a cell may be anything."""
        columns = self.names if wanted is None else tuple(wanted)
        try:
            with self._text() as stream:
                if size is not None:
                    yield from self._parsed(stream, size, columns)
                    return
                text = stream.read()
            values = _plain_values(text, len(self.names))
            if values is None:
                yield from self._parsed(io.StringIO(text), text.count("\n") + 1, columns)
            else:
                numbers = {name: column for name, column in zip(self.names, values, strict=True) if name in columns}
                yield ColumnTable(columns=numbers, where=str(self.path), first_row=2)
        except UnicodeDecodeError as error:
            raise self._not_text(f": {error}") from None

    def rows(self) -> int:
        """By the length of its first lines."""
        with self.path.open("rb") as stream:
            start = stream.read(HEADER_BYTES)
        return self.path.stat().st_size * start.count(b"\n") // max(len(start), 1)

    def _text(self) -> _Text:
        try:
            return _Text(self.path.open("rb") if self.content is None else io.BytesIO(self.content), self._binary)
        except OSError as error:
            raise unreadable(self.path, error) from None

    def _parsed(self, text: io.TextIOBase, size: int, wanted: Sequence[str]) -> Iterator[ColumnTable]:
        """The wanted columns of any CSV of finite numbers there, quoted ones too; InputError for any other."""
        import pandas as pd  # slow to import

        numbers = dict.fromkeys(wanted, np.float64)
        frames = parsed_rows(text, size, header=0, names=[*self.names], dtype=numbers, skip_blank_lines=False)
        row = 2
        try:
            while True:
                with warnings.catch_warnings():  # rows that are too long would be cut off with no more than a warning
                    warnings.simplefilter("error", pd.errors.ParserWarning)
                    frame = next(frames, None)
                if frame is None:
                    return
                yield table_from_frame(frame[list(wanted)], str(self.path), row)
                row += len(frame)
        except UnicodeDecodeError:
            raise
        except (InputError, ValueError, OverflowError, pd.errors.ParserWarning) as error:
            with self._text() as lines:
                raise_first_bad_cell(lines, self.names, str(self.path), wanted)
            if isinstance(error, InputError):
                raise
            raise self.error(f"cannot be read: {error}", "correct the file") from None

    def _binary(self) -> InputError:
        return self.error("a binary file, no recording in CSV or Parquet", import_remedy(str(self.path)))

    def _not_text(self, reason: str = "") -> InputError:
        return self.error(f"not UTF-8 text{reason}", import_remedy(str(self.path)))


class _Text(io.TextIOWrapper):
    """UTF-8 text of a stream, lines ending in one way, without white space at its end; refused if it has NUL."""

    def __init__(self, stream: BinaryIO, refusal: Callable[[], InputError]) -> None:
        super().__init__(stream, encoding="utf-8-sig")
        self.refusal, self.blanks = refusal, ""

    def read(self, size: int | None = -1) -> str:
        """About `size` characters, by default all; none at the end."""
        while block := super().read(size):
            if "\0" in block:
                raise self.refusal()
            text = self.blanks + block
            kept = text.rstrip()
            self.blanks = text[len(kept) :]
            if kept:
                return kept
        return ""


def parsed_rows(text: io.TextIOBase, size: int, **layout: Any) -> Iterator[pd.DataFrame]:
    """The rows of a text in frames of `size`, as pandas parses them in this layout, its options; exact to a double."""
    import pandas as pd  # slow to import

    with pd.read_csv(text, index_col=False, skipinitialspace=True, chunksize=size, **layout) as frames:
        yield from frames


def _plain_values(text: str, columns: int) -> Array | None:
    """The numbers (columns, n) of a CSV of finite decimal numbers alone; None for any other.

    NumPy reads such a file as fast as pandas, which takes longer to import than to read it.
    """
    header, _, body = text.partition("\n")
    if '"' in header or not body or body.encode().translate(None, PLAIN_CSV_BYTES):
        return None
    try:
        values = np.loadtxt(io.StringIO(body), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    whole = values.shape == (body.count("\n") + 1, columns)  # NumPy passes over rows that are empty
    return np.ascontiguousarray(values.T) if whole and _are_plausible(values) else None


def header_names(text: str, where: str) -> list[str]:
    """The names of the columns in the first row of a CSV file's text; InputError when it is not a header."""
    try:
        names = [name.strip() for name in next(csv.reader(io.StringIO(text)))]
    except csv.Error as error:
        what = f"row 1 cannot be read: {error}"
        raise InputError(what=what, where=where, remedy="correct that row") from None
    if len(names) == 1 and re.search(r"[;\s]", names[0]):
        what = "the columns are not separated by commas"
        raise InputError(
            what=what,
            where=where,
            remedy=f"write a CSV with commas, and points in the numbers, or {import_remedy(where)}",
        )
    if all(re.fullmatch(r"[-+.\deE]+", name) for name in names):
        raise InputError(
            what="row 1 is not a header", where=where, remedy=f"name the columns there, or {import_remedy(where)}"
        )
    return require_own_names(names, where)


def require_own_names(names: Sequence[str], where: str) -> list[str]:
    """The names of a recording's columns; InputError when none of them is one, or some are empty or duplicated."""
    if not any(OWN_NAMES.fullmatch(name) for name in names):
        shown = ", ".join(map(cut, names[:SHOWN_NAMES])) + ", .." * (len(names) > SHOWN_NAMES)
        what = f"a log, no recording: of its columns ({shown}) none is a wrench or a motion, such as fx, q1, phi or qx"
        raise InputError(what=what, where=where, remedy=import_remedy(where))
    for i, name in enumerate(names):
        if not name:
            what = f"column {i + 1} has no name"
            remedy = f"name it in the header, remove it, or {import_remedy(where)}"
            raise InputError(what=what, where=where, remedy=remedy)
        if name in names[:i]:
            what = f"column {cut(name)} is duplicated"
            remedy = f"rename or remove one of them, or {import_remedy(where)}"
            raise InputError(what=what, where=where, remedy=remedy)
    return list(names)


def raise_first_bad_cell(lines: Iterable[str], names: Sequence[str], where: str, wanted: Container[str]) -> None:
    """Raise the InputError of the first cell of a wanted column that is not a finite number; slow, after a failure."""
    reader = csv.reader(lines, strict=True)
    try:
        next(reader)
        for cells in reader:
            _raise_bad_cell(cells, names, reader.line_num, where, wanted)
    except csv.Error as error:
        what = f"row {reader.line_num} cannot be read: {error}"
        raise InputError(what=what, where=where, remedy="correct that row") from None


def _raise_bad_cell(cells: Sequence[str], names: Sequence[str], row: int, where: str, wanted: Container[str]) -> None:
    if len(cells) != len(names):
        what = f"row {row} has {len(cells)} values, and the header has {len(names)} columns"
        raise InputError(what=what, where=where, remedy="complete or remove that row")
    for name, cell in ((n, c) for n, c in zip(names, cells, strict=True) if n in wanted):
        if not cell.strip():
            what = f"column {cut(name)} is empty at row {row}"
            remedy = f"fill in the value, remove the row, or {import_remedy(where)}"
            raise InputError(what=what, where=where, remedy=remedy)
        try:
            number = float(cell) if "_" not in cell else None
        except ValueError:
            number = None
        if number is None:
            what = f"column {cut(name)} is not a number at row {row}: {cell.strip()[:40]!r}"
            raise InputError(what=what, where=where, remedy=_numeric_remedy(where))
        if not _are_plausible(number):
            raise _implausible(name, cell.strip(), row, where)


def _are_plausible(values: ArrayLike) -> bool:
    """Whether numbers are finite, and not larger than any that is measured; NaN is neither below nor above anything."""
    numbers = np.asarray(values)
    return not numbers.size or bool(numbers.min() > -LARGEST_VALUE and numbers.max() < LARGEST_VALUE)


def _implausible(name: str, value: object, row: int, where: str) -> InputError:
    what = f"column {cut(name)} is {cut(value)} at row {row}"
    return InputError(
        what=what, where=where, remedy=f"replace it by a number below {LARGEST_VALUE:g}, or remove the row"
    )


def table_from_arrow(table: pa.Table | pa.RecordBatch, where: str, first_row: int = 1) -> ColumnTable:
    """Arrow's columns, without a copy where possible, each checked as `table_from_frame` does."""
    kinds = arrow().types

    def contiguous(column: pa.ChunkedArray | pa.Array) -> pa.Array:
        return column.combine_chunks() if isinstance(column, arrow().ChunkedArray) else column

    columns: dict[str, Array] = {}
    for name, column in zip(table.schema.names, map(contiguous, table.columns), strict=True):
        is_numeric = column.null_count == 0 and (kinds.is_integer(column.type) or kinds.is_floating(column.type))
        values = np.from_dlpack(column) if is_numeric else np.full(1, np.nan)  # `to_numpy` would import pandas
        if not _are_plausible(values):
            return table_from_frame(table.to_pandas(ignore_metadata=True), where, first_row)
        columns[name] = values.astype(np.float64, copy=False)
    return ColumnTable(columns=columns, where=where, first_row=first_row)


def table_from_frame(frame: pd.DataFrame, where: str, first_row: int = 1) -> ColumnTable:
    """A data frame's columns, checked to be finite numbers; `first_row` is the row of the first sample in its file."""
    columns = {}
    for name in frame.columns:
        column = frame[name]
        if not _is_real(column):
            what = f"column {cut(name)} is not numeric but {column.dtype} from row {first_row} on"
            raise InputError(what=what, where=where, remedy=_numeric_remedy(where))
        values = column.to_numpy(dtype=float, na_value=np.nan, copy=True)
        wrong = np.flatnonzero(~(np.abs(values) < LARGEST_VALUE))
        if wrong.size:
            raise _implausible(name, values[wrong[0]], int(wrong[0]) + first_row, where)
        columns[str(name)] = values
    return _nonempty_table(columns, where=where, first_row=first_row)


def table_from_columns(columns: Mapping[str, ArrayLike], where: str) -> ColumnTable:
    """Columns (n,) by name, checked to be finite numbers; rows are counted from 1."""
    import pandas as pd  # slow to import

    arrays = {key: np.asarray(column) for key, column in columns.items()}
    if len({array.shape for array in arrays.values()}) > 1 or any(array.ndim != 1 for array in arrays.values()):
        shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
        remedy = "give one array per column, all of one length"
        raise InputError(what=f"columns of different shapes: {shapes}", where=where, remedy=remedy)
    return table_from_frame(pd.DataFrame(arrays), where)


def _is_real(column: pd.Series) -> bool:
    import pandas as pd  # slow to import

    kind = pd.api.types
    is_excluded = kind.is_bool_dtype(column) or kind.is_complex_dtype(column)
    return kind.is_numeric_dtype(column) and not is_excluded


def _nonempty_table(columns: Mapping[str, Array], *, where: str, first_row: int) -> ColumnTable:
    if not columns or not len(next(iter(columns.values()))):
        raise InputError(what="there are no samples", where=where, remedy="give a recording with rows")
    return ColumnTable(columns=columns, where=where, first_row=first_row)
