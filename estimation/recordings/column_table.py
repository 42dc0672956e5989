"""Table of named numeric columns from CSV, Parquet, Arrow or pandas, with validation errors that name the cell."""

from __future__ import annotations

import csv
import io
import re
import shlex
import warnings
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.errors import InputError, cut

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


# SI unit of a signal of the motion by its name.


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


Array: TypeAlias = NDArray[np.float64]

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


def table_from_file(path: Path) -> ColumnTable:
    """The table in a CSV or Parquet file; rows are counted with a CSV's header as row 1."""
    content = _content(path)
    parquet = path.suffix.lower() in (".parquet", ".pq") or content.startswith(b"PAR1")
    return _parquet_table(content, str(path)) if parquet else _csv_table(content, str(path))


def _content(path: Path) -> bytes:
    if path.is_char_device():  # /dev/zero has no end
        raise InputError(
            what="a device, no recording", where=str(path), remedy="give the path of a CSV or Parquet file"
        )
    try:
        content = path.read_bytes()
    except OSError as error:
        if path.is_dir():
            what, remedy = "a directory, no recording", import_remedy(str(path))
        else:
            what, remedy = error.strerror or "cannot be read", "give the path of a CSV or Parquet file"
        raise InputError(what=what, where=str(path), remedy=remedy) from None
    if not content.strip():
        raise InputError(what="the file is empty", where=str(path), remedy="give a recording with a header row")
    return content


def _csv_table(content: bytes, where: str) -> ColumnTable:
    text = _decoded(content, where)
    names = header_names(text, where)
    values = _plain_values(text, len(names))
    columns = _pandas_columns(text, names, where) if values is None else dict(zip(names, values, strict=True))
    return _nonempty_table(columns, where=where, first_row=2)


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
    whole = values.shape == (body.count("\n"), columns)  # NumPy passes over rows that are empty
    return np.ascontiguousarray(values.T) if whole and _are_plausible(values) else None


def _pandas_columns(text: str, names: list[str], where: str) -> dict[str, Array]:
    """The columns of any CSV of finite numbers, quoted ones too; InputError for any other."""
    import pandas as pd  # slow to import

    try:
        with warnings.catch_warnings():
            # Rows that are too long would be cut off with no more than this warning.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                io.StringIO(text),
                header=0,
                names=names,
                index_col=False,
                dtype=np.float64,
                skip_blank_lines=False,
            )
        if _are_plausible(frame.to_numpy()):
            return {name: frame[name].to_numpy(dtype=float) for name in names}
        problem = "a value is missing, or no number that is measured"
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:  # parser errors are ValueErrors
        problem = str(error)
    raise_first_bad_cell(io.StringIO(text), names, where, names)
    raise InputError(what=problem, where=where, remedy="correct the file")


def _decoded(content: bytes, where: str) -> str:
    remedy = import_remedy(where)
    if b"\0" in content:
        raise InputError(what="a binary file, no recording in CSV or Parquet", where=where, remedy=remedy)
    try:
        text = content.decode("utf-8-sig").rstrip() + "\n"
    except UnicodeDecodeError as error:
        raise InputError(what=f"not UTF-8 text: {error}", where=where, remedy=remedy) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")  # the csv module refuses lines that end in CR only


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


def _parquet_table(content: bytes, where: str) -> ColumnTable:
    import pyarrow as pa  # slow to import, and a CSV does not need it
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(io.BytesIO(content)).read()  # `read_table` would import pandas
    except (pa.ArrowException, OSError, ValueError) as error:
        what = f"not a Parquet file: {error}"
        raise InputError(what=what, where=where, remedy="give a CSV or Parquet file") from None
    require_own_names(table.column_names, where)
    wanted = table.select([name for name in table.column_names if not PANDAS_INDEX_NAME.fullmatch(name)])
    return _nonempty_table(table_from_arrow(wanted, where).columns, where=where, first_row=1)


def table_from_arrow(table: pa.Table | pa.RecordBatch, where: str, first_row: int = 1) -> ColumnTable:
    """Arrow's columns, without a copy where possible, each checked as `table_from_frame` does."""
    import pyarrow as pa  # slow to import, though not as slow as pandas

    def contiguous(column: pa.ChunkedArray | pa.Array) -> pa.Array:
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column

    columns: dict[str, Array] = {}
    for name, column in zip(table.schema.names, map(contiguous, table.columns), strict=True):
        is_numeric = column.null_count == 0 and (pa.types.is_integer(column.type) or pa.types.is_floating(column.type))
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
