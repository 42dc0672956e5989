"""Reader of Parquet files."""

from __future__ import annotations

import numpy as np

from estimation.logs.log_reader import LogReader, require_columns, require_size
from estimation.logs.log_table import Array, LogTable
from estimation.logs.source_file import SourceFile


class Parquet(LogReader):
    """Parquet; null is a missing cell, and what is not numeric is text."""

    title = "Parquet"

    def recognises(self, source: SourceFile) -> bool:
        """By its magic string."""
        return source.head.startswith(b"PAR1")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """One table."""
        import pyarrow as pa  # slow to import
        import pyarrow.parquet as pq

        with source.on_disk() as path, pq.ParquetFile(path) as file:
            require_columns(file.metadata.num_columns, str(source.path))
            require_size(file.metadata.num_columns * file.metadata.num_rows, str(source.path))
            table = file.read()
        columns: dict[str, Array] = {}
        texts: dict[str, tuple[str, ...]] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            kind = column.type
            if pa.types.is_timestamp(kind):
                columns[name] = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy().astype(np.float64) * 1e-9
            elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
                columns[name] = np.asarray(column.cast(pa.float64()).to_numpy(), dtype=np.float64)
            else:
                texts[name] = tuple(str(value)[:60] for value in column.slice(0, 3).to_pylist())
        return [LogTable(name=source.name, kind="Parquet", columns=columns, texts=texts)]
