"""Reader of Excel workbooks (.xlsx), one table a sheet; formulas by the values that were saved with them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np

from estimation.logs.log_reader import LogReader, require_columns, require_size
from estimation.logs.log_table import Array, LogTable, unique_names
from estimation.logs.source_file import SourceFile

HEADER_ROWS = 30
"""Rows from the top among which the header is looked for."""
LARGEST_BOOK = 256 << 20
"""Bytes of a workbook's XML: its cells as Python objects take several times as much memory."""


class Excel(LogReader):
    """Excel workbook."""

    title = "Excel .xlsx"

    def recognises(self, source: SourceFile) -> bool:
        """A zip file that is named .xlsx or .xlsm."""
        return source.suffix in (".xlsx", ".xlsm") and source.head.startswith(b"PK")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """The sheets that hold numbers."""
        import openpyxl  # slow to import

        source.require_members(LARGEST_BOOK)
        with source.path.open("rb") as stream:
            book = openpyxl.load_workbook(stream, read_only=True, data_only=True)
            sheets = [(sheet.title, _rows(sheet, str(source.path))) for sheet in book.worksheets]
        found = [_table(f"{source.name}:{title}", rows) for title, rows in sheets if rows]
        return [table for table in found if table is not None]


def _rows(sheet: Any, where: str) -> list[tuple[Any, ...]]:
    require_columns(sheet.max_column or 0, where)
    rows, cells = [], 0
    for row in sheet.iter_rows(values_only=True):
        cells += len(row)
        require_size(cells, where)
        rows.append(row)
    return rows


def _number(cell: Any) -> float:
    if isinstance(cell, str):
        try:
            return float(cell.strip().replace(",", "."))
        except ValueError:
            return np.nan
    if hasattr(cell, "timestamp"):
        return float(cell.timestamp())
    return float(cell) if isinstance(cell, int | float) else np.nan


def _is_data(row: Sequence[Any]) -> bool:
    filled = [cell for cell in row if cell is not None and cell != ""]
    return bool(filled) and sum(np.isfinite(_number(cell)) for cell in filled) >= 0.5 * len(filled)


def _table(name: str, rows: Sequence[Sequence[Any]]) -> LogTable | None:
    first = next((i for i, row in enumerate(islice(rows, HEADER_ROWS)) if _is_data(row)), None)
    if first is None:
        return None
    width = max(len(row) for row in rows)
    header = next((row for row in reversed(rows[:first]) if any(isinstance(cell, str) for cell in row)), ())
    names = unique_names([str(cell or "") for cell in header] + [""] * (width - len(header)))
    columns: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for place, title in enumerate(names):
        cells = [row[place] if place < len(row) else None for row in rows[first:]]
        numbers = np.array([_number(cell) for cell in cells])
        if np.isfinite(numbers).any():
            columns[title] = numbers
        elif words := [str(cell) for cell in cells if cell is not None]:
            texts[title] = tuple(dict.fromkeys(words))[:3]
    return LogTable(name=name, kind="Excel sheet", columns=columns, texts=texts)
