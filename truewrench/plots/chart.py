"""A chart: panels of marks with data, labels and units; matplotlib and Bokeh draw it from the same numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.reading_report import extremes, min_max_decimated
from modeling.number_format import format_number
from truewrench.plots.style import INK, MUTED, NOISE, WIDTH

Array: TypeAlias = NDArray[np.float64]

LOG_MARGIN = 1.2
ENLARGED = 1.5
"""Ratio of the scales of two panels of one quantity from which it is said."""
MARGIN = 0.06
"""Of the span of the values, beyond the outermost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Line:
    """A series y (n,) over x (n,); long ones are decimated by whoever draws them."""

    x: Array
    y: Array
    colour: str
    width: float = 1.2
    opacity: float = 1.0
    dashed: bool = False
    steps: bool = False
    label: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Points:
    """Values y (n,) at x (n,), with bars from low to high (n,) where there are any, and notes left of them.

    interval   what the bars are, where they are intervals of the values: "95 %"
    """

    x: Array
    y: Array
    colour: str
    size: float = 4.0
    hollow: bool = False
    symbol: str = "o"
    low: Array | None = None
    high: Array | None = None
    interval: str = ""
    notes: tuple[str, ...] = ()
    label: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Band:
    """A shaded region between low and high: of all x where they are numbers, else series (n,) over x (n,)."""

    low: float | Array
    high: float | Array
    x: Array | None = None
    colour: str = NOISE
    opacity: float = 1.0
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class Span:
    """A shaded interval of x."""

    start: float
    end: float
    colour: str
    opacity: float = 0.2
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class Level:
    """A horizontal line, with a word at its end."""

    y: float
    colour: str = MUTED
    dashed: bool = False
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Horizontal bars of named sizes, the first on top, each with its colour and a note beside it."""

    names: tuple[str, ...]
    sizes: tuple[float, ...]
    colours: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Heat:
    """Values (rows, columns) as colours; rows are named, columns named or at x; NaN is empty."""

    values: Array
    rows: tuple[str, ...]
    columns: tuple[str, ...] = ()
    x: Array | None = None
    limits: tuple[float, float] = (0.0, 1.0)
    colours: tuple[str, ...]
    scale: str
    written: bool = False

    @property
    def ends(self) -> tuple[float, float]:
        """Where the first column begins and the last one ends: half a column beyond their middles."""
        count = self.values.shape[1]
        first, last = (0.0, count - 1.0) if self.x is None else (float(self.x[0]), float(self.x[-1]))
        half = (last - first) / max(count - 1, 1) / 2 or 0.5
        return first - half, last + half


Mark: TypeAlias = Line | Points | Band | Span | Level | Bars | Heat


@dataclass(frozen=True, eq=False, kw_only=True)
class Panel:
    """Marks on one pair of axes.

    x_label, y_label  with the unit; y_label is needed where there is a quantity
    x_ticks           names at 0, 1, 2, ... of an axis without numbers
    x_limits, y_limits  by default those of the marks
    note              a remark in a corner
    """

    marks: tuple[Mark, ...]
    title: str = ""
    title_colour: str = INK
    x_label: str = ""
    y_label: str = ""
    x_ticks: tuple[str, ...] = ()
    x_log: bool = False
    y_log: bool = False
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None
    note: str = ""

    @property
    def drawn(self) -> tuple[Mark, ...]:
        """The marks that have data."""
        return tuple(mark for mark in self.marks if not isinstance(mark, Line | Points) or len(mark.x))

    @property
    def span(self) -> float:
        """Length of a linear y axis in its unit; zero where it is logarithmic or not given."""
        return 0.0 if self.y_limits is None or self.y_log else self.y_limits[1] - self.y_limits[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Chart:
    """Rows of panels; None is an empty place.

    heights      relative, of the rows
    row_height   CSS pixels, on average
    main         row and column of the panel that is drawn on a user's single axes
    shared_x     whether all panels of a column have one x axis
    shared_y     whether all panels of a row have one y axis
    left, right  CSS pixels beside the panels, at least
    legend, panel_legends  whether there is one, and whether each panel has its own
    """

    rows: tuple[tuple[Panel | None, ...], ...]
    title: str = ""
    heights: tuple[float, ...] = ()
    row_height: float = 130
    main: tuple[int, int] = (0, 0)
    shared_x: bool = False
    shared_y: bool = False
    width: float | None = None
    left: float = 66
    right: float = 12
    between_rows: float = 30
    between_columns: float | None = None
    legend: bool = True
    panel_legends: bool = False

    @property
    def columns(self) -> int:
        """Number of columns."""
        return max(len(row) for row in self.rows)

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All panels, row by row."""
        return tuple(panel for panel in chain(*self.rows) if panel is not None)

    @property
    def page_width(self) -> float:
        """Width of the whole figure on a page, CSS pixels."""
        return self.width or (WIDTH if self.columns > 1 else 0.62 * WIDTH)

    @property
    def labelled_rows(self) -> tuple[tuple[Panel | None, ...], ...]:
        """The rows of panels: labels of shared axes only on the outermost ones, remarks where scales differ."""
        widest = self._widest_spans()
        return tuple(
            tuple(panel and self._labelled(panel, row, column, widest) for column, panel in enumerate(line))
            for row, line in enumerate(self.rows)
        )

    def _labelled(self, panel: Panel, row: int, column: int, widest: Mapping[str, float]) -> Panel:
        inner = self.shared_y and column > 0
        return replace(
            panel,
            x_label="" if self.shared_x and row < len(self.rows) - 1 else panel.x_label,
            y_label="" if inner else panel.y_label,
            note=panel.note or ("" if inner else enlargement(panel, widest.get(panel.y_label, 0.0))),
        )

    def _widest_spans(self) -> dict[str, float]:
        """The longest axis of each quantity that several panels show."""
        widest: dict[str, float] = {}
        for panel in self.panels:
            if panel.y_label:
                widest[panel.y_label] = max(widest.get(panel.y_label, 0.0), panel.span)
        return widest

    @property
    def main_panel(self) -> Panel:
        """The panel for a single pair of axes."""
        panel = self.rows[self.main[0]][self.main[1]]
        return self.panels[0] if panel is None else panel


def enlargement(panel: Panel, widest: float) -> str:
    """By how much the y axis is enlarged against the longest axis of the same quantity; empty for about the same."""
    if not panel.span or widest / panel.span < ENLARGED:
        return ""
    return f"y axis enlarged {format_number(widest / panel.span, 2)} times"


def legend_labels(panels: Iterable[Panel]) -> list[str]:
    """Labels of all marks that are drawn, each once, in the order that they have in every panel.

    A panel lists its marks whether they have data or not, so that legends of one kind of panel are in one order.
    """
    order: list[str] = []
    shown: set[str] = set()
    for panel in panels:
        labels = [label for mark in panel.marks if (label := getattr(mark, "label", ""))]
        shown |= {getattr(mark, "label", "") for mark in panel.drawn}
        for number, label in enumerate(labels):
            if label not in order:
                later = [order.index(other) for other in labels[number:] if other in order]
                order.insert(min(later, default=len(order)), label)
    return [label for label in order if label in shown]


def in_rows(panels: Sequence[Panel], columns: int) -> tuple[tuple[Panel | None, ...], ...]:
    """Panels in rows of so many columns, the last row filled with empty places."""
    count = min(columns, max(len(panels), 1))
    padded: list[Panel | None] = [*panels, *[None] * (-len(panels) % count)]
    return tuple(tuple(padded[i : i + count]) for i in range(0, len(padded), count))


def value_limits(values: Sequence[Array | float], *, log: bool = False) -> tuple[float, float]:
    """Limits that contain all finite values (positive ones on a logarithmic axis), with a margin."""
    finite = np.concatenate([np.ravel(np.asarray(v, dtype=np.float64)) for v in values])
    finite = finite[np.isfinite(finite) & ((finite > 0) | (not log))]
    if not len(finite):
        return (0.1, 10.0) if log else (-1.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if log:
        return low / LOG_MARGIN, high * LOG_MARGIN
    margin = MARGIN * (high - low) or abs(high) * MARGIN or 1.0
    return low - margin, high + margin


# Marks of a chart thinned to what a screen can show: the smallest and the largest value in each column of pixels.


def decimated(line: Line, columns: int, *, log: bool) -> tuple[Array, Array]:
    """x and y of the line with at most two points in each of so many columns; of a logarithmic axis equal in log x."""
    if len(line.x) <= 2 * columns:
        return line.x, line.y
    if not log:
        return min_max_decimated(line.x, line.y, columns)
    starts = np.unique(_columns(line.x, columns, log=log), return_index=True)[1]
    return extremes(line.x, line.y, np.append(starts, len(line.x)))


def thinned(points: Points, columns: int, *, log: bool) -> Points:
    """The lowest and the highest of the points in each of so many columns; all of few, and of those with notes."""
    if len(points.x) <= 2 * columns or points.notes:
        return points
    place = _columns(points.x, columns, log=log)
    order = np.lexsort((points.y, place))
    ends = np.flatnonzero(np.diff(place[order], prepend=-1, append=columns + 1))
    kept = np.unique(np.concatenate([order[ends[:-1]], order[ends[1:] - 1]]))
    low, high = (None if bars is None else bars[kept] for bars in (points.low, points.high))
    return replace(points, x=points.x[kept], y=points.y[kept], low=low, high=high)


def _columns(x: Array, columns: int, *, log: bool) -> Array:
    """In which of so many columns each x is; on a logarithmic axis they are equal in log x."""
    across = np.log(x) if log else x
    return np.asarray(np.floor(columns * (across - across.min()) / (np.ptp(across) or 1.0)))
