"""Table of a result: named columns of numbers and text, printed as text, HTML, Markdown or a pandas data frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from itertools import zip_longest
from math import isfinite
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from modeling.errors import InputError
from modeling.number_format import NO_VALUE, axis_label, plain_number, typeset_number, typeset_text, typeset_units

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


# What every result has beside its table: text, figure, plain data and labelled arrays, made by a package above the one
# that the result belongs to.


class Presenter(Protocol):
    """A module that presents results of all packages."""

    def summary(self, result: Any) -> str:
        """The result as text."""

    def plot(self, result: Any, **options: Any) -> Any:
        """The result as a picture."""

    def picture(self, result: Any) -> str:
        """The figure of a result as HTML, empty where it has none."""

    def show(self, result: Any, height: int) -> Any:
        """The result as a page to work with, in a frame of so many CSS pixels."""

    def data(self, result: Any) -> dict[str, Any]:
        """The result as plain data."""

    def dataset(self, result: Any) -> Any:
        """The result as labelled arrays."""


_modules: list[str] = []


def register_presenter(module: str) -> None:
    """Name the module that presents results; it is imported when first asked."""
    _modules[:] = [module]


def presenter() -> Presenter:
    """The presenting module; InputError where none was registered."""
    if not _modules:
        raise InputError(what="no package presents results", where="plot", remedy="import truewrench first")
    module: Any = import_module(_modules[0])
    presenting: Presenter = module
    return presenting


class Presented:
    """A result with a summary, a figure, plain data, and labelled arrays where it has dimensions."""

    def summary(self) -> str:
        """The result as text, with everything worth knowing about it."""
        return presenter().summary(self)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data that JSON can write: numbers are finite or None.

        Of a fit and of a model that `load` gave it is that of a model file, and `load` takes it.
        """
        return presenter().data(self)

    def to_xarray(self) -> xr.Dataset:
        """The result's arrays with named dimensions, coordinates and units; needs xarray.

        Raises
        ------
        InputError
            For a result without dimensions, and where xarray is not installed.
        """
        dataset: xr.Dataset = presenter().dataset(self)
        return dataset

    def plot(
        self, kind: str | None = None, *, channel: str | None = None, backend: str = "matplotlib", ax: Any = None
    ) -> Any:
        """The result as a figure, of matplotlib for print or of Bokeh for zooming; both show the same numbers.

        Parameters
        ----------
        kind : str, optional
            What to draw, where there are several kinds of figures; a wrong one is answered by those there are.
        channel : str, optional
            Channel of a figure of one channel, by default the worst.
        backend : str, optional
            "matplotlib", the default; any other name, such as "bokeh", draws with the interactive library, Bokeh.
        ax : matplotlib.axes.Axes, or a sequence of them, optional
            Axes to draw on, by default a figure of its own: one gets the main panel, as many as there are panels get
            all.

        Returns
        -------
        matplotlib.figure.Figure or InteractiveFigure
            Shown by a notebook; `figure.savefig("file.png")` writes it, `figure.write_html("file.html")` an interactive
            one, as a page that needs no network; its `layout` is what Bokeh draws.

        Raises
        ------
        InputError
            For a result without a figure, and an unknown kind, channel or axes.
        """
        return presenter().plot(self, kind=kind, channel=channel, backend=backend, ax=ax)


MOST_LINES = 38
"""Of the `repr` of a result; `print` shows all."""
CELL_STYLE = "padding: 3px 14px 3px 0; vertical-align: top"
"""Of a cell, where no page has a style sheet."""
NOTE_STYLE = ' style="display: block"'
"""Of the note in a cell, likewise: on a line of its own."""


@dataclass(frozen=True)
class Cell:
    """A value with a mark before it (`<`, `~`), and what HTML alone shows: its kind (CSS class), a note below it.

    The mark of no value stands alone, a word that says why there is none: `fixed`. A `format` is that of this number,
    by default the column's.
    """

    value: float | str | None
    mark: str = ""
    kind: str = ""
    note: str = ""
    format: str = ""


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
        return [piece for line in text.splitlines() for piece in wrap(line, self.width, subsequent_indent="  ")]

    def typeset(self, value: Value) -> str:
        """An entry with powers of ten and signs typeset."""
        return typeset_units(self._written(value, typeset_number, NO_VALUE if self.unknown == "-" else self.unknown))

    def html(self, value: Value, *, styled: bool = False) -> str:
        """An entry as a `<td>`."""
        text = escape(self.typeset(value)).replace("\n", "<br>")
        kind, note = (value.kind, value.note) if isinstance(value, Cell) else ("", "")
        below = f"<small{NOTE_STYLE if styled else ''}>{escape(note)}</small>" if note else ""
        return f"<td{self._class(kind)}{self._style(styled)}>{text}{below}</td>"

    def _written(self, value: Value, number: Callable[[float, str], str], unknown: str) -> str:
        content, mark = (value.value, value.mark) if isinstance(value, Cell) else (value, "")
        if isinstance(content, str):
            return mark + content
        if content is None and mark:
            return mark
        form = (value.format if isinstance(value, Cell) else "") or self.format
        return unknown if content is None or not isfinite(content) else mark + number(content, form)

    @property
    def typeset_heading(self) -> str:
        """Name, with the typeset unit in round brackets."""
        return axis_label(self.name, self.unit)

    def html_heading(self, *, styled: bool = False) -> str:
        """The heading as a `<th>`."""
        return f"<th{self._class('')}{self._style(styled)}>{escape(self.typeset_heading)}</th>"

    def _style(self, styled: bool) -> str:
        """Numbers and their heading end at one edge, text begins at one."""
        place = "right; white-space: nowrap" if self.format else "left"
        return f' style="text-align: {place}; {CELL_STYLE}"' if styled else ""

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

    @property
    def filled(self) -> Table:
        """The table without the columns in which no row has a value: every entry is None or an empty text."""
        places = range(len(self.columns))
        kept = [i for i in places if not self.rows or any(row[i] not in (None, "") for row in self.rows)]
        return Table(tuple(self.columns[i] for i in kept), tuple(tuple(row[i] for i in kept) for row in self.rows))

    def __str__(self) -> str:
        columns, rows = self.filled.columns, self.filled.rows
        cells = [[c.lines(v) for c, v in zip(columns, row, strict=True)] for row in rows]
        if any(c.heading for c in columns):
            cells.insert(0, [[c.heading] for c in columns])
        widths = [c.width or max(len(t) for row in cells for t in row[i]) for i, c in enumerate(columns)]
        rule = ["  ".join("-" * width for width in widths)] if any(c.width for c in columns) else []
        return "\n".join(line for row in cells for line in [*_aligned(row, widths), *rule])

    def __repr__(self) -> str:
        return shortened(str(self))

    def to_html(self) -> str:
        """The table as HTML that is aligned in any page; names and text are escaped."""
        return self._html(styled=True)

    _repr_html_ = to_html

    def __html__(self) -> str:
        """The table as HTML for a page with a style sheet: numbers have the class `number`."""
        return self._html(styled=False)

    def _html(self, *, styled: bool) -> str:
        columns, rows = self.filled.columns, self.filled.rows
        named = any(c.heading for c in columns)
        head = "".join(c.html_heading(styled=styled) for c in columns) if named else ""
        body = "".join(
            f"<tr>{''.join(c.html(v, styled=styled) for c, v in zip(columns, row, strict=True))}</tr>\n" for row in rows
        )
        return f"<table>\n{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>\n{body}</tbody></table>"

    def to_markdown(self) -> str:
        """The table in Markdown, with numbers and units typeset as in HTML."""
        columns = self.filled.columns
        rows = [[c.typeset_heading for c in columns], ["---"] * len(columns)]
        rows += [[c.typeset(v) for c, v in zip(columns, row, strict=True)] for row in self.filled.rows]
        return "\n".join("| " + " | ".join(t.replace("|", "\\|").replace("\n", " ") for t in r) + " |" for r in rows)

    def to_frame(self) -> pd.DataFrame:
        """The values under the headings, those of a column with a format as numbers, NaN for none.

        Of an entry with a mark (`< 0.02`, an upper limit) the number alone.
        """
        import pandas as pd

        columns = [[v.value if isinstance(v, Cell) else v for v in column] for column in zip(*self.rows, strict=True)]
        series = [
            pd.to_numeric(pd.Series([None if v == "" else v for v in column])) if c.format else pd.Series(column)
            for c, column in zip(self.columns, columns or [[] for _ in self.columns], strict=True)
        ]
        frame = pd.DataFrame(dict(enumerate(series)))
        frame.columns = pd.Index([c.heading for c in self.columns])
        return frame


def shortened(text: str) -> str:
    """The text, of a long one the first and last lines."""
    lines = text.splitlines()
    if len(lines) <= MOST_LINES:
        return text
    kept, last = lines[: MOST_LINES - 6], lines[-5:]
    return "\n".join([*kept, f".. {len(lines) - len(kept) - len(last)} lines left out; print() shows all ..", *last])


def _aligned(row: Sequence[Sequence[str]], widths: Sequence[int]) -> Iterator[str]:
    for cells in zip_longest(*row, fillvalue=""):
        yield "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip()


class Tabular(Presented, ABC):
    """A result that shows itself as a table with remarks below it, in a notebook with its figure too.

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
        words = [p.to_html() if isinstance(p, Table) else f"<p>{escape(typeset_text(p))}</p>" for p in self.printed()]
        return "\n".join([*words, presenter().picture(self)] if _modules else words)
