"""CSV or Parquet file read in blocks of rows, only the wanted columns."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.column_table import (
    ColumnTable,
    header_names,
    import_remedy,
    raise_first_bad_cell,
    require_own_names,
    table_from_arrow,
    table_from_frame,
)
from modeling.errors import InputError

Array = NDArray[np.float64]

PARQUET_BUFFER = 2**18
"""Bytes of each column read from a Parquet file at once, whatever the length of its row groups."""
FILE_REMEDY = "give a CSV or Parquet file with a header"


@dataclass(frozen=True, kw_only=True)
class ChunkedFile(ABC):
    """A file of named numeric columns."""

    path: Path
    names: tuple[str, ...]

    @abstractmethod
    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[ColumnTable]:
        """The wanted columns in tables of `size` rows, the last one shorter.

        Raises InputError, with the row in the file, for a value that is not a finite number.
        """

    def refused(self, reason: object) -> InputError:
        """The InputError of a file that cannot be read."""
        return InputError(what=f"cannot be read: {reason}", where=str(self.path), remedy=FILE_REMEDY)


class ParquetColumns(ChunkedFile):
    """A Parquet file; rows are counted from 1."""

    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[ColumnTable]:
        """The wanted columns, across row groups; few pages of each are in memory at once."""
        yield from _of_size(self._batches(size, wanted), size)

    def _batches(self, size: int, wanted: Sequence[str]) -> Iterator[ColumnTable]:
        import pyarrow as pa  # slow to import
        import pyarrow.parquet as pq

        row = 1
        try:
            with pq.ParquetFile(self.path, pre_buffer=False, buffer_size=PARQUET_BUFFER) as file:
                for batch in file.iter_batches(batch_size=size, columns=list(wanted), use_threads=False):
                    yield table_from_arrow(batch, str(self.path), row)
                    row += batch.num_rows
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self.refused(error) from None


class CsvColumns(ChunkedFile):
    """A CSV file; rows are counted with its header as row 1."""

    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[ColumnTable]:
        """The wanted columns; the others are not parsed."""
        import pandas as pd  # slow to import

        row = 2
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # rows that are too long
                reader = pd.read_csv(
                    self.path, chunksize=size, header=0, names=list(self.names), index_col=False,
                    dtype=dict.fromkeys(wanted, np.float64), encoding="utf-8-sig", skipinitialspace=True,
                )  # fmt: skip
            with reader:
                while True:
                    with warnings.catch_warnings():
                        warnings.simplefilter("error", pd.errors.ParserWarning)
                        frame = next(reader, None)
                    if frame is None:
                        return
                    yield table_from_frame(frame[list(wanted)], str(self.path), row)
                    row += len(frame)
        except (OSError, ValueError, OverflowError, pd.errors.ParserWarning) as error:
            self._raise_first_bad_cell(wanted)
            raise self.refused(error) from None
        except InputError:
            self._raise_first_bad_cell(wanted)
            raise

    def _raise_first_bad_cell(self, wanted: Sequence[str]) -> None:
        """Raise the InputError of the first cell that is not a finite number; slow, after a failure."""
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as lines:
                raise_first_bad_cell(lines, self.names, str(self.path), wanted)
        except (OSError, UnicodeDecodeError) as error:
            raise self.refused(error) from None


def open_chunked_file(path: Path) -> ChunkedFile:
    """The file at that path; only its column names are read. Raises InputError when it has none."""
    try:
        with path.open("rb") as file:
            start = file.read(4)
    except OSError as error:
        remedy = import_remedy(str(path)) if path.is_dir() else FILE_REMEDY
        raise InputError(what=f"cannot be read: {error.strerror}", where=str(path), remedy=remedy) from None
    if path.suffix.lower() in (".parquet", ".pq") or start == b"PAR1":
        return ParquetColumns(path=path, names=_parquet_names(path))
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            header = next((line for line in lines if line.strip()), "")
    except UnicodeDecodeError as error:
        raise InputError(what=f"not UTF-8 text: {error}", where=str(path), remedy=import_remedy(str(path))) from None
    if not header:
        raise InputError(what="the file is empty", where=str(path), remedy=FILE_REMEDY)
    return CsvColumns(path=path, names=tuple(header_names(header, str(path))))


def _parquet_names(path: Path) -> tuple[str, ...]:
    import pyarrow as pa  # slow to import
    import pyarrow.parquet as pq

    try:
        names = pq.read_schema(path).names
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(what=f"cannot be read: {error}", where=str(path), remedy=FILE_REMEDY) from None
    return tuple(require_own_names([n for n in names if not n.startswith("__index_level_")], str(path)))


def _of_size(tables: Iterator[ColumnTable], size: int) -> Iterator[ColumnTable]:
    """The same rows in tables of one size, the last one shorter."""
    held: list[ColumnTable] = []
    for table in tables:
        held.append(table)
        while sum(map(len, held)) >= size:
            whole = _joined(held)
            yield whole if len(whole) == size else _part(whole, 0, size)
            held = [_part(whole, size, len(whole))] if len(whole) > size else []
    if held and sum(map(len, held)):
        yield _joined(held)


def _joined(tables: Sequence[ColumnTable]) -> ColumnTable:
    """Consecutive tables of the same columns as one."""
    first = tables[0]
    if len(tables) == 1:
        return first
    columns = {name: np.concatenate([table.columns[name] for table in tables]) for name in first.columns}
    return ColumnTable(columns=columns, where=first.where, first_row=first.first_row)


def _part(table: ColumnTable, start: int, end: int) -> ColumnTable:
    columns: Mapping[str, Array] = {name: values[start:end] for name, values in table.columns.items()}
    return ColumnTable(columns=columns, where=table.where, first_row=table.first_row + start)


def with_history(tables: Iterator[ColumnTable], overlap: int) -> Iterator[tuple[ColumnTable, int]]:
    """Each table preceded by up to `overlap` earlier rows, and their number."""
    held: ColumnTable | None = None
    for table in tables:
        whole = table if held is None else _joined([held, table])
        yield whole, len(whole) - len(table)
        if overlap:
            held = _part(whole, max(len(whole) - overlap, 0), len(whole))
