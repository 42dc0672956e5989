"""Reader of delimited text: any separator, decimal comma, with header or without, comment lines, text columns."""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from estimation.reading.log_reader import (
    HEAD_BYTES,
    MAX_CELLS,
    Array,
    LogReader,
    LogTable,
    SourceFile,
    require_columns,
    require_size,
    unique_names,
)
from estimation.recordings.column_table import parsed_rows

if TYPE_CHECKING:
    import pandas as pd


SAMPLE_LINES = 300
"""Lines by which separator, decimal sign and header are recognised."""
LAYOUT_LINES = 4 * SAMPLE_LINES
"""Lines among which the first row of numbers is looked for: headers of hundreds of lines occur."""
LEAST_SCORE = 0.1
"""Share of the cells that are numbers in rows of one length, below which a text is no log."""
LONE_COLUMN = 0.6
"""Weight of a dialect that finds one column alone: any line is one cell of it."""
ROW_SHARE = 0.3
"""Of a row's filled cells that are numbers; the others may be states, modes and names."""
SNIFFED_BYTES = 1 << 16
"""By which text is told from binary content."""
LATIN_SHARE = 0.7
"""Of the bytes that are ASCII in a text; of random ones half are."""
LONGEST_LINE = 4 * HEAD_BYTES
"""Bytes: no robot writes a sample as long."""
CHUNK_CELLS = 2_000_000
"""Cells that are parsed at once, 16 MB of numbers."""
FEWEST_CHUNK_ROWS = 1000
"""Of a chunk, however many columns there are."""
SPARE_ROWS, FEWEST_ROWS = 1.05, 100
"""Factor on the rows that are expected by the length of the first lines, and rows more, so that arrays seldom grow."""
TEXT_LENGTH, SHOWN_LENGTH, SHOWN_NAMES = 60, 20, 4
"""Characters of a text that are kept and shown, and names that a message repeats."""
TEXTS_KEPT = 5
"""Different texts of a column that are kept: enough for a message, and to see a frame that is always the same."""
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
MISSING = ("", "-", "--", "n/a", "na", "null", "none", "#n/a")
UNIT = re.compile(r"[\[(]?(s|sec|ms|us|µs|ns|m|mm|cm|rad|deg|°|n|nm|n\.m|n\*m|n m|mnm|c|°c|-|1|m/s|rad/s|hz)[\])]?")
BINARY = bytes(set(range(9)) | set(range(14, 27)) | {28, 29, 30, 31})
"""Control characters that no text file has."""
ABOVE_ASCII = bytes(range(128, 256))


@dataclass(frozen=True)
class Dialect:
    """How the cells of a line are separated; `separator` " " is any white space, ", " commas and white space mixed."""

    separator: str
    decimal: str

    def cells(self, line: str) -> list[str]:
        """The cells of a line."""
        if self.separator == ", ":
            return re.split(r"[,\s]+", line.strip().strip(","))
        if self.separator == " ":
            return line.split()
        return [cell.strip() for cell in next(csv.reader([line], delimiter=self.separator), [])]

    def is_number(self, cell: str) -> bool:
        """Whether the cell is a number."""
        return bool((DECIMAL_COMMA if self.decimal == "," else NUMBER).fullmatch(cell))


DIALECTS = (
    *(Dialect(separator, ".") for separator in (",", ";", "\t", "|", " ")),
    *(Dialect(separator, ",") for separator in (";", "\t", "|", " ")),
    Dialect(", ", "."),
)
"""Of those in which as many cells are numbers the first."""


@dataclass(frozen=True)
class Layout:
    """What the first lines show: dialect, names, units, lines before the first row of numbers, comment sign."""

    dialect: Dialect
    names: tuple[str, ...]
    has_header: bool
    skipped: int
    comment: str | None


class DelimitedText(LogReader):
    """Text with one row of numbers a line."""

    title = "CSV or other text"
    rank = 100

    def recognises(self, source: SourceFile) -> bool:
        """Text has no NUL and next to no other control characters, but in UTF-16."""
        head = source.head[:SNIFFED_BYTES]
        if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return True
        return bool(head.strip()) and len(head.translate(None, BINARY)) == len(head) and _is_mostly_text(head)

    def tables(self, source: SourceFile) -> list[LogTable]:
        """One table."""
        encoding = encoding_of(source.head)
        layout = _layout(source, source.head.decode(encoding, errors="replace"))
        with source.opened() as binary:
            return [_table(source, layout, _Text(source, binary, encoding))]


def _is_mostly_text(head: bytes) -> bool:
    """Latin letters and digits, signs and white space: random bytes are above 127 in every second case."""
    return len(head.translate(None, ABOVE_ASCII)) > LATIN_SHARE * len(head)


def encoding_of(head: bytes) -> str:
    """UTF-8 where the bytes are, UTF-16 with its mark, else Latin-1, in which every byte is a letter."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


class _Text(io.TextIOBase):
    """The text of a binary stream in blocks, checked for binary content; commas become spaces where both separate."""

    def __init__(self, source: SourceFile, stream: BinaryIO, encoding: str) -> None:
        super().__init__()
        self.source, self.stream, self.wide = source, stream, encoding == "utf-16"
        self.decoder = codecs.getincrementaldecoder(encoding)(errors="replace")
        self.mixed = False
        self.since_newline = 0

    def readable(self) -> bool:
        """True."""
        return True

    def read(self, size: int | None = -1) -> str:
        """About `size` characters; none at the end."""
        block = self.stream.read(HEAD_BYTES if size is None or size < 0 else size)
        if not self.wide and b"\0" in block:
            raise self.source.error("binary content among the lines", "give a text file that is whole")
        newline = max(block.rfind(b"\n"), block.rfind(b"\r"))
        self.since_newline = len(block) - newline if newline >= 0 else self.since_newline + len(block)
        if self.since_newline > LONGEST_LINE:
            raise self.source.error("a line longer than 4 MB", "give a text file with one sample a line")
        text = self.decoder.decode(block, not block).replace("\r\n", "\n").replace("\r", "\n")
        if not text and block:
            return self.read(size)
        return text.replace(",", " ") if self.mixed else text


# --------------------------------------------------------------------------------------------- layout


def _layout(source: SourceFile, text: str) -> Layout:
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    if len(source.head) == HEAD_BYTES:
        lines = lines[:-1]  # the last one may be cut
        if not lines:
            raise source.error("row 1 is longer than 1 MB", "give a text file with one sample a line")
    lines = lines[:LAYOUT_LINES]
    if not any(line.strip() for line in lines):
        raise source.error("the file is empty", "give a log with rows of numbers")
    dialect, width = _dialect(source, lines)
    require_columns(width, str(source.path))
    first = _first_row(lines, dialect, width)
    names, has_header = _names(lines[:first], dialect, width)
    comments = {line.lstrip()[0] for line in lines[first:] if line.lstrip()[:1] in ("#", "%")}
    return Layout(dialect, tuple(names), has_header, first, min(comments, default=None))


def _dialect(source: SourceFile, lines: Sequence[str]) -> tuple[Dialect, int]:
    """The dialect in which most cells are numbers and the rows equally long, and the cells of a row."""
    sample = [line for line in lines if line.strip() and line.lstrip()[0] not in "#%"][-SAMPLE_LINES:]
    if not sample:
        raise source.error("there are no samples", "give a log with rows of numbers")
    best, best_rank = (DIALECTS[0], 0.0, 0), (-1.0, False)
    for dialect in DIALECTS:
        score, width = _score(sample, dialect)
        rank = (round(score, 2) * (1.0 if width > 1 else LONE_COLUMN), width > 1)
        if rank > best_rank:
            best, best_rank = (dialect, score, width), rank
        if best_rank == (1.0, True):
            break  # none is better
    dialect, score, width = best
    if score < LEAST_SCORE:
        raise source.error("no rows of numbers are found in its first lines", "give a text file with one sample a line")
    return dialect, width


def _score(sample: Sequence[str], dialect: Dialect) -> tuple[float, int]:
    """Share of the lines that are as long as most in a dialect, times that of numbers in them, and their cells."""
    rows = [dialect.cells(line) for line in sample]
    counts = [len(row) for row in rows]
    width = max(set(counts), key=lambda count: (counts.count(count), count))
    usual = [row for row in rows if len(row) == width]
    filled = [cell for row in usual for cell in row if cell.lower() not in MISSING]
    numbers = sum(map(dialect.is_number, filled)) / max(len(filled), 1)
    return len(usual) / len(rows) * numbers, width


def _first_row(lines: Sequence[str], dialect: Dialect, width: int) -> int:
    """Index of the first line that is a row of numbers."""
    for place, line in enumerate(lines):
        if not line.strip() or line.lstrip()[0] in "#%":
            continue
        cells = [cell for cell in dialect.cells(line) if cell.lower() not in MISSING]
        numbers = sum(map(dialect.is_number, cells))
        if numbers and numbers >= ROW_SHARE * len(cells):
            return place
    return 0


def _names(before: Sequence[str], dialect: Dialect, width: int) -> tuple[list[str], bool]:
    """Names of the columns from the lines before the first row, with the units of a line of units in brackets."""
    rows = [_header_cells(line, dialect, width) for line in before if line.strip()]
    heads = [cells for cells in rows if len(cells) >= max(width - 1, 1) and any(cells)]
    if not heads:
        return [f"column_{place + 1}" for place in range(width)], False
    names, units = heads[-1], [""] * width
    if len(heads) > 1 and all(UNIT.fullmatch(cell.lower()) for cell in names if cell):
        names, units = heads[-2], names
    names = [*names, *[""] * width][: max(width, len(names))]
    named = [
        f"{n} ({u.strip('[]()')})" if u.strip("[]()-1") else n
        for n, u in zip(names, [*units, *[""] * len(names)], strict=False)
    ]
    return named, True


def _header_cells(line: str, dialect: Dialect, width: int) -> list[str]:
    line = line.lstrip()
    marked = line[:1] in ("#", "%")
    line = re.sub(r"^\[(.*)\]$", r"\1", line.lstrip("#%").strip()) if marked else line
    cells = dialect.cells(line)
    if len(cells) != width and dialect.separator == " ":
        others = [re.split(r"\t+| {2,}", line), [c.strip() for c in line.split(",")]]
        cells = next((other for other in others if len(other) == width), cells)
    return [cell.strip().strip(",").strip('"').strip() for cell in cells]


# ---------------------------------------------------------------------------------------------- cells


def _table(source: SourceFile, layout: Layout, text: _Text) -> LogTable:
    names = unique_names(layout.names)
    text.mixed = layout.dialect.separator == ", "
    columns = _Columns(names, layout.dialect.decimal, _expected_rows(source))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for chunk in _chunks(source, layout, text, len(names)):
            columns.add(chunk)
            require_size(columns.rows * len(names), str(source.path))
    long_rows = sum(str(w.message).count("Skipping line") for w in caught)
    numbers, texts, notes = columns.finished()
    if long_rows:
        notes.append(("rows with too many cells left out", long_rows, True))
    if layout.has_header and (
        again := [name for name in names if re.search(r"\.\d+$", name) and name not in layout.names]
    ):
        notes.append((f"duplicated or unnamed column, renamed: {', '.join(again[:SHOWN_NAMES])}", len(again), False))
    title = f"text, separated by {_SEPARATOR[layout.dialect.separator]}"
    title += ", decimal comma" if layout.dialect.decimal == "," else ""
    title += "" if layout.has_header else ", without header"
    return LogTable(name=source.name, kind=title, columns=numbers, texts=texts, notes=tuple(notes))


_SEPARATOR = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces", ", ": "commas and spaces"}


def _chunks(source: SourceFile, layout: Layout, text: _Text, columns: int) -> Iterator[pd.DataFrame]:
    import pandas as pd  # slow to import

    separator = layout.dialect.separator
    try:
        yield from parsed_rows(
            text, max(CHUNK_CELLS // columns, FEWEST_CHUNK_ROWS), sep=r"\s+" if separator in (" ", ", ") else separator,
            decimal=layout.dialect.decimal, header=None, names=list(range(columns)), skiprows=layout.skipped,
            comment=layout.comment, na_values=["-", "--", "none", "None"], on_bad_lines="warn",
        )  # fmt: skip
    except pd.errors.EmptyDataError:
        return
    except pd.errors.ParserError as error:
        raise source.error(f"its rows cannot be read: {error}", "give a text file with one sample a line") from None


def _expected_rows(source: SourceFile) -> int:
    """Lines of the file by the length of the first ones, a little more than likely; few of a compressed file."""
    lines = source.head.count(b"\n") + 1
    size = source.path.stat().st_size if source.compression is None else len(source.head)
    return int(SPARE_ROWS * size * lines / max(len(source.head), 1)) + FEWEST_ROWS


class _Columns:
    """Columns that grow by chunks: numbers, and of text the first values.

    Memory is asked for once, by the rows that are expected, and used as rows come: parts that are put together in the
    end would be in memory twice.
    """

    def __init__(self, names: Sequence[str], decimal: str, expected: int) -> None:
        self.names, self.decimal, self.rows = names, decimal, 0
        self.arrays = [np.empty(min(expected, MAX_CELLS // max(len(names), 1) + 1)) for _ in names]
        self.texts: list[dict[str, None]] = [{} for _ in names]
        self.bad = [0] * len(names)

    def add(self, chunk: pd.DataFrame) -> None:
        """Add the rows of a chunk; cells that are no numbers become NaN."""
        end = self.rows + len(chunk)
        for place in range(len(self.names)):
            if end > len(self.arrays[place]):
                grown = np.empty(2 * end)
                grown[: self.rows] = self.arrays[place][: self.rows]
                self.arrays[place] = grown
            self.arrays[place][self.rows : end] = self._numbers(chunk[place], place)
        self.rows = end

    def _numbers(self, column: pd.Series, place: int) -> Array:
        import pandas as pd

        if column.dtype.kind in "fiub":
            return column.to_numpy(dtype=np.float64)
        cells = column.astype(str).str.strip()
        numbers = pd.to_numeric(
            cells.str.replace(",", ".", regex=False) if self.decimal == "," else cells, errors="coerce"
        )
        wrong = numbers.isna() & column.notna() & ~cells.str.lower().isin([*MISSING, "nan"])
        if wrong.any():
            self.bad[place] += int(wrong.sum())
            for cell in cells[wrong].drop_duplicates()[:TEXTS_KEPT]:
                self.texts[place].setdefault(cell[:TEXT_LENGTH])
        return numbers.to_numpy(dtype=np.float64)

    def finished(self) -> tuple[dict[str, Array], dict[str, tuple[str, ...]], list[tuple[str, int, bool]]]:
        """Numeric columns, columns of text, and notes; columns without any cell are left out."""
        numbers: dict[str, Array] = {}
        texts: dict[str, tuple[str, ...]] = {}
        notes: list[tuple[str, int, bool]] = []
        empty = 0
        for place, name in enumerate(self.names):
            column = self.arrays[place][: self.rows]
            finite = int(np.isfinite(column).sum())
            if self.bad[place] > finite:
                texts[name] = tuple(self.texts[place])[:TEXTS_KEPT]
            elif finite:
                numbers[name] = column
                if self.bad[place]:
                    shown = next(iter(self.texts[place]))
                    notes.append(
                        (
                            f"cells of {name} that are no numbers, such as {shown[:SHOWN_LENGTH]!r}, taken as missing",
                            self.bad[place],
                            False,
                        )
                    )
            else:
                empty += 1
        if empty:
            notes.append(("empty columns left out", empty, False))
        return numbers, texts, notes
