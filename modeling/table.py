"""Table of a result: named columns of numbers and text, printed as text, HTML, Markdown or a pandas data frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from math import isfinite
from textwrap import wrap
from typing import TYPE_CHECKING, TypeAlias

from modeling.number_format import NO_VALUE, format_unit, plain_number, typeset_number
from modeling.presented import Presented

if TYPE_CHECKING:
    import pandas as pd

MOST_LINES = 38
"""Of the `repr` of a result; `print` shows all."""
NOT_IDENTIFIABLE = "not identifiable"
"""Printed for the standard deviation of an unidentifiable parameter, which is infinite."""


@dataclass(frozen=True)
class Cell:
    """A value with a mark before it (`<`, `~`), and what HTML alone shows: its kind (CSS class), a note below it."""

    value: float | str | None
    mark: str = ""
    kind: str = ""
    note: str = ""


Value: TypeAlias = float | str | Cell | None
"""Entry of a table: a number, text, or None for none."""


@dataclass(frozen=True)
class Column:
    """Column of a table.

    name, unit  of its heading
    format      of its numbers: a format specification of Python, `P_VALUE` or `SHARE`
    unknown     text for None and for numbers that are not finite
    width       characters after which text is wrapped; 0 is never
    """

    name: str
    unit: str = ""
    format: str = ""
    unknown: str = "-"
    width: int = 0

    @property
    def heading(self) -> str:
        """Name, with the unit in brackets."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def text(self, value: Value) -> str:
        """An entry as plain text."""
        return self._written(value, plain_number, self.unknown)

    def lines(self, value: Value) -> list[str]:
        """An entry as plain text, wrapped at the width."""
        text = self.text(value)
        if not self.width:
            return [text]
        return [part for line in text.splitlines() for part in wrap(line, self.width, subsequent_indent="  ")]

    def html(self, value: Value) -> str:
        """An entry as a `<td>`."""
        unknown = NO_VALUE if self.unknown == "-" else self.unknown
        text = escape(self._written(value, typeset_number, unknown)).replace("\n", "<br>")
        kind, note = (value.kind, value.note) if isinstance(value, Cell) else ("", "")
        return f"<td{self._class(kind)}>{text}{f'<small>{escape(note)}</small>' if note else ''}</td>"

    def _written(self, value: Value, number: Callable[[float, str], str], unknown: str) -> str:
        found, mark = (value.value, value.mark) if isinstance(value, Cell) else (value, "")
        if isinstance(found, str):
            return mark + found
        return unknown if found is None or not isfinite(found) else mark + number(found, self.format)

    @property
    def html_heading(self) -> str:
        """The heading as a `<th>`."""
        unit = format_unit(self.unit)
        return f"<th{self._class('')}>{escape(f'{self.name} ({unit})' if unit else self.name)}</th>"

    def _class(self, kind: str) -> str:
        names = " ".join(name for name in ("number" if self.format else "", kind) if name)
        return f' class="{escape(names)}"' if names else ""


@dataclass(frozen=True, repr=False)
class Table(Presented):
    """Columns and rows of entries, a row as long as the columns; without any heading only the rows are printed."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]

    @classmethod
    def of(cls, columns: Iterable[Column | str], rows: Iterable[Sequence[Value]]) -> Table:
        """A name alone is a column of text."""
        named = tuple(Column(c) if isinstance(c, str) else c for c in columns)
        return cls(named, tuple(tuple(row) for row in rows))

    def without_unknown(self, *names: str) -> Table:
        """Without those columns of these names in which no row has a value."""
        kept = [
            i
            for i, column in enumerate(self.columns)
            if column.name not in names or any(row[i] not in (None, "") for row in self.rows)
        ]
        return Table(tuple(self.columns[i] for i in kept), tuple(tuple(row[i] for i in kept) for row in self.rows))

    def __str__(self) -> str:
        cells = [[c.lines(v) for c, v in zip(self.columns, row, strict=True)] for row in self.rows]
        if any(c.heading for c in self.columns):
            cells.insert(0, [[c.heading] for c in self.columns])
        widths = [c.width or max(len(t) for row in cells for t in row[i]) for i, c in enumerate(self.columns)]
        rule = ["  ".join("-" * width for width in widths)] if any(c.width for c in self.columns) else []
        return "\n".join(line for row in cells for line in [*_aligned(row, widths), *rule])

    def __repr__(self) -> str:
        return shortened(str(self))

    def to_html(self) -> str:
        """The table as HTML; numbers have the class `number`, names and text are escaped."""
        head = "".join(c.html_heading for c in self.columns) if any(c.heading for c in self.columns) else ""
        body = "".join(
            f"<tr>{''.join(c.html(v) for c, v in zip(self.columns, row, strict=True))}</tr>\n" for row in self.rows
        )
        return f"<table>\n{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>\n{body}</tbody></table>"

    __html__ = _repr_html_ = to_html

    def to_markdown(self) -> str:
        """The table in Markdown."""
        rows = [[c.heading for c in self.columns], ["---"] * len(self.columns)]
        rows += [[c.text(v) for c, v in zip(self.columns, row, strict=True)] for row in self.rows]
        return "\n".join("| " + " | ".join(t.replace("|", "\\|").replace("\n", " ") for t in r) + " |" for r in rows)

    def to_frame(self) -> pd.DataFrame:
        """The values, numbers as numbers, under the headings."""
        import pandas as pd

        values = [[v.value if isinstance(v, Cell) else v for v in row] for row in self.rows]
        return pd.DataFrame(values, columns=[c.heading for c in self.columns])


def shortened(text: str) -> str:
    """The text, of a long one the first and last lines."""
    lines = text.splitlines()
    if len(lines) <= MOST_LINES:
        return text
    kept, last = lines[: MOST_LINES - 6], lines[-5:]
    return "\n".join([*kept, f".. {len(lines) - len(kept) - len(last)} lines left out; print() shows all ..", *last])


def _aligned(row: Sequence[Sequence[str]], widths: Sequence[int]) -> Iterator[str]:
    for parts in zip_longest(*row, fillvalue=""):
        yield "  ".join(part.ljust(width) for part, width in zip(parts, widths, strict=True)).rstrip()


class Tabular(Presented, ABC):
    """A result that shows itself as a table with remarks below it, on a terminal and in a notebook.

    Its `repr` is that table: dataclasses among the subclasses do not list their fields.
    """

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:  # so that the decorator `dataclass` finds one, and writes none
            cls.__repr__ = Tabular.__repr__  # type: ignore[method-assign]

    @property
    @abstractmethod
    def table(self) -> Table:
        """The result as a table."""

    def remarks(self) -> list[str]:
        """Sentences below the table."""
        return []

    def printed(self) -> list[Table | str]:
        """Tables and sentences, in the order in which they are printed."""
        return [self.table, *self.remarks()]

    def to_frame(self) -> pd.DataFrame:
        """The table as a pandas data frame."""
        return self.table.to_frame()

    def __str__(self) -> str:
        return "\n".join(map(str, self.printed()))

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        return "\n".join(p.to_html() if isinstance(p, Table) else f"<p>{escape(p)}</p>" for p in self.printed())
