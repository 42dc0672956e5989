"""Column file: a CSV or Parquet file read in stretches, those columns alone that are wanted."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.table import Table, arrow_table, explain, frame_table, header_names, unique_names
from modeling.errors import InputError

Array = NDArray[np.float64]

BUFFER = 2**18
"""Bytes of each column that are read from a Parquet file at once, however long its row groups are."""
READABLE = "give a CSV or Parquet file with a header"


@dataclass(frozen=True, kw_only=True)
class ColumnFile(ABC):
    """A file with a column of numbers under each of its names."""

    path: Path
    names: tuple[str, ...]

    @abstractmethod
    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[Table]:
        """The wanted columns in tables of `size` rows, the last one of less.

        Raises InputError, with the row in the file, for what is no finite number.
        """

    def refused(self, reason: object) -> InputError:
        """The InputError of a file that cannot be read."""
        return InputError(what=f"cannot be read: {reason}", where=str(self.path), remedy=READABLE)


class ParquetColumns(ColumnFile):
    """A Parquet file; rows are counted from 1."""

    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[Table]:
        """The wanted columns, row groups joined; few pages of each are held at once."""
        yield from _of_size(self._batches(size, wanted), size)

    def _batches(self, size: int, wanted: Sequence[str]) -> Iterator[Table]:
        import pyarrow as pa  # slow to import
        import pyarrow.parquet as pq

        row = 1
        try:
            with pq.ParquetFile(self.path, pre_buffer=False, buffer_size=BUFFER) as file:
                for batch in file.iter_batches(batch_size=size, columns=list(wanted), use_threads=False):
                    yield arrow_table(batch, str(self.path), row)
                    row += batch.num_rows
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self.refused(error) from None


class CsvColumns(ColumnFile):
    """A CSV file; rows are counted with its header as row 1."""

    def stretches(self, size: int, wanted: Sequence[str]) -> Iterator[Table]:
        """The wanted columns; what stands in the others is not looked at."""
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
                    yield frame_table(frame[list(wanted)], str(self.path), row)
                    row += len(frame)
        except (OSError, ValueError, OverflowError, pd.errors.ParserWarning) as error:
            self._explain(wanted)
            raise self.refused(error) from None
        except InputError:
            self._explain(wanted)
            raise

    def _explain(self, wanted: Sequence[str]) -> None:
        """Raise the InputError of the first cell that is no finite number; the slow way, only after trouble."""
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as lines:
                explain(lines, self.names, str(self.path), wanted)
        except (OSError, UnicodeDecodeError) as error:
            raise self.refused(error) from None


def column_file(path: Path) -> ColumnFile:
    """The file at that path, of which the names alone are read. Raises InputError when there are none."""
    try:
        with path.open("rb") as file:
            start = file.read(4)
    except OSError as error:
        raise InputError(what=f"cannot be read: {error.strerror}", where=str(path), remedy=READABLE) from None
    if path.suffix.lower() in (".parquet", ".pq") or start == b"PAR1":
        return ParquetColumns(path=path, names=_parquet_names(path))
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            header = next((line for line in lines if line.strip()), "")
    except UnicodeDecodeError as error:
        raise InputError(what=f"not UTF-8 text: {error}", where=str(path), remedy=READABLE) from None
    if not header:
        raise InputError(what="the file is empty", where=str(path), remedy=READABLE)
    return CsvColumns(path=path, names=tuple(header_names(header, str(path))))


def _parquet_names(path: Path) -> tuple[str, ...]:
    import pyarrow as pa  # slow to import
    import pyarrow.parquet as pq

    try:
        names = pq.read_schema(path).names
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(what=f"cannot be read: {error}", where=str(path), remedy=READABLE) from None
    return tuple(unique_names([n for n in names if not n.startswith("__index_level_")], str(path)))


def _of_size(tables: Iterator[Table], size: int) -> Iterator[Table]:
    """The same rows in tables of one size, the last one of less."""
    held: list[Table] = []
    for table in tables:
        held.append(table)
        while sum(map(len, held)) >= size:
            whole = _joined(held)
            yield whole if len(whole) == size else _part(whole, 0, size)
            held = [_part(whole, size, len(whole))] if len(whole) > size else []
    if held and sum(map(len, held)):
        yield _joined(held)


def _joined(tables: Sequence[Table]) -> Table:
    """Tables of the same columns that follow each other as one."""
    first = tables[0]
    if len(tables) == 1:
        return first
    columns = {name: np.concatenate([table.columns[name] for table in tables]) for name in first.columns}
    return Table(columns=columns, where=first.where, first_row=first.first_row)


def _part(table: Table, start: int, end: int) -> Table:
    columns: Mapping[str, Array] = {name: values[start:end] for name, values in table.columns.items()}
    return Table(columns=columns, where=table.where, first_row=table.first_row + start)


def with_history(tables: Iterator[Table], overlap: int) -> Iterator[tuple[Table, int]]:
    """Each table with up to `overlap` rows of those before it, and how many they are."""
    held: Table | None = None
    for table in tables:
        whole = table if held is None else _joined([held, table])
        yield whole, len(whole) - len(table)
        if overlap:
            held = _part(whole, max(len(whole) - overlap, 0), len(whole))
