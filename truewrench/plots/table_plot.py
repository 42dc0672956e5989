"""The numbers of a table as bars: the figure of a result that has no other."""

from __future__ import annotations

from math import isfinite

from modeling.errors import InputError
from modeling.number_format import format_number
from modeling.table import Cell, Table, Value
from truewrench.plots.charts.chart import Bars, Chart, Panel, in_rows
from truewrench.plots.style import ADEQUATE_COLOUR

MOST_ROWS, MOST_COLUMNS, ROW = 30, 8, 18
"""Rows and columns drawn, the first ones; height of a row in CSS pixels."""


def table_chart(table: Table) -> Chart:
    """A panel for each column of numbers, a bar for each row, named by the row's text.

    Raises InputError for a table without numbers.
    """
    rows = table.rows[:MOST_ROWS]
    kept = [i for i in range(len(table.columns)) if any(_number(row[i]) is not None for row in rows)][:MOST_COLUMNS]
    if not kept:
        raise InputError(what="there are no numbers to draw", where="plot", remedy="print it, or use to_frame()")
    names = _distinct([" ".join(_text(v) for v in row if _text(v))[:24] or str(n) for n, row in enumerate(rows, 1)])
    panels = [_panel(table, i, rows, names) for i in kept]
    return Chart(rows=in_rows(panels, 2), row_height=max(ROW * len(rows), 36), left=160, right=70, between_rows=60,
                 legend=False, between_columns=240)  # fmt: skip


def _panel(table: Table, column: int, rows: tuple[tuple[Value, ...], ...], names: list[str]) -> Panel:
    known = [(name, _number(row[column])) for name, row in zip(names, rows, strict=True)]
    bars = Bars(
        names=tuple(name for name, _ in known),
        sizes=tuple(value or 0.0 for _, value in known),
        colours=(ADEQUATE_COLOUR,) * len(known),
        notes=tuple(format_number(value) for _, value in known),
    )
    return Panel(marks=(bars,), title=table.columns[column].heading)


def _number(value: Value) -> float | None:
    found = value.value if isinstance(value, Cell) else value
    return float(found) if isinstance(found, int | float) and isfinite(found) else None


def _text(value: Value) -> str:
    found = value.value if isinstance(value, Cell) else value
    return found if isinstance(found, str) else ""


def _distinct(names: list[str]) -> list[str]:
    """Names that differ: a bar is placed by its name."""
    return [name if names.count(name) == 1 else f"{name} ({number})" for number, name in enumerate(names, 1)]
