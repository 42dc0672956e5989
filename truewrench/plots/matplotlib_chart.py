"""A chart drawn by matplotlib: on a figure of its own, or on a user's axes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from itertools import pairwise, takewhile
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Annotation
from matplotlib.ticker import FixedLocator, FuncFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from modeling.errors import InputError, kind_of
from truewrench.plots.chart import (
    Band,
    Bars,
    Chart,
    Heat,
    Level,
    Line,
    Panel,
    Points,
    Span,
    decimated,
    legend_labels,
    thinned,
)
from truewrench.plots.style import (
    EDGE,
    INK,
    LEGEND,
    MUTED,
    NORMAL,
    PIXELS_PER_INCH,
    SMALL,
    TITLE_CHARACTER,
    PanelGrid,
    label_y_axis,
    panel_title,
    style_axes,
)

# Places of the short notes in a panel of matplotlib: beside what they name, off the lines and off each other.


Array = NDArray[np.float64]

STEP = 3.0
"""Pixels between the points of a line that a note keeps off."""
OUTSIDE, WRITTEN_OVER = 1e6, 1e4
"""Cost of a place that leaves the panel, and of one on another note, in points of a line."""


@dataclass(frozen=True)
class Place:
    """A place of a note: `at` in coordinates of its own, or as they are, and the offset in points from there."""

    offset: tuple[float, float]
    across: str
    up: str
    at: tuple[float, float] | None = None


AROUND_POINT = (
    Place((-8, 0), "right", "center"),
    Place((8, 0), "left", "center"),
    Place((0, 8), "center", "bottom"),
    Place((0, -8), "center", "top"),
    Place((-7, 6), "right", "bottom"),
    Place((-7, -6), "right", "top"),
    Place((7, 6), "left", "bottom"),
    Place((7, -6), "left", "top"),
)
CORNERS = tuple(
    Place((0, 0), across, up, ({"left": 0.008, "right": 0.995}[across], {"top": 0.97, "bottom": 0.03}[up]))
    for across, up in (("right", "top"), ("left", "top"), ("right", "bottom"), ("left", "bottom"))
)


def along_level(y: float) -> tuple[Place, ...]:
    """Above or below a horizontal line at a height, at its end, its beginning or between."""
    between = tuple(("center", x) for x in np.linspace(0.9, 0.1, 17).tolist())
    return tuple(
        Place((0, 2 if up == "bottom" else -2), across, up, (x, y))
        for across, x in (("right", 0.995), ("left", 0.008), *between)
        for up in ("bottom", "top")
    )


@dataclass(frozen=True)
class Note:
    """A note that is drawn, and where it may be, the best first."""

    text: Annotation
    places: tuple[Place, ...]

    @classmethod
    def at_first(cls, text: Annotation, places: tuple[Place, ...]) -> Note:
        """The note at its best place."""
        _move(text, places[0])
        return cls(text, places)


def place_notes(axes: Axes, notes: Sequence[Note]) -> None:
    """Move each note to the first place where nothing is written over, else to the one where the least is.

    The panel must have its final size.
    """
    if not notes:
        return
    lines = np.concatenate([*_points_of_lines(axes), np.empty((0, 2))])
    panel, taken = axes.get_window_extent(), list[Bbox]()
    for note in notes:
        costs = []
        for number, place in enumerate(note.places):
            _move(note.text, place)
            costs.append((_cost(note.text.get_window_extent(), panel, lines, taken), number))
        _move(note.text, note.places[min(costs)[1]])
        taken.append(note.text.get_window_extent())


def _move(text: Annotation, place: Place) -> None:
    if place.at is not None:
        text.xy = place.at
    text.set_position(place.offset)
    text.set(ha=place.across, va=place.up)


def _cost(box: Bbox, panel: Bbox, lines: Array, taken: Sequence[Bbox]) -> float:
    """Points of lines in the box, and much more for what is outside the panel or on another note."""
    low, high = np.array([box.x0, box.y0]), np.array([box.x1, box.y1])
    covered = float(((lines > low) & (lines < high)).all(axis=1).sum())
    leaves: bool = box.x0 < panel.x0 or box.x1 > panel.x1 + 1 or box.y0 < panel.y0 - 1 or box.y1 > panel.y1 + 1
    written_over = sum(bool(box.overlaps(other)) for other in taken)
    return covered + OUTSIDE * float(leaves) + WRITTEN_OVER * written_over


def _points_of_lines(axes: Axes) -> Iterator[Array]:
    """Points in pixels along every line and interval, close enough that no note is between two of them."""
    for line in axes.lines:
        yield _dense(line.get_transform().transform(line.get_xydata()))
    for collection in (c for c in axes.collections if isinstance(c, LineCollection)):
        for segment in collection.get_segments():
            yield _dense(axes.transData.transform(segment))


def _dense(points: Any) -> Array:
    path = np.asarray(points, dtype=np.float64)
    path = path[np.isfinite(path).all(axis=1)]
    if len(path) < 2:
        return path
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    at = np.arange(0.0, length[-1] + STEP, STEP)
    between = np.stack([np.interp(at, length, path[:, i]) for i in (0, 1)], axis=1)
    return np.concatenate([path, between])


# Margins of a grid of panels by what its texts need, so that nothing is cut off and no row is written over another.


LEAST_GAP = 14.0
"""Between rows of panels, CSS pixels."""
GAP = 8.0
"""Between the texts of neighbouring panels."""
TICK_GAP = 12.0
"""Between the labels of neighbouring ticks; with less they are turned."""
TURN = 28
"""Degrees."""
NARROWER = 0.9
"""Of a panel's first width, below which its texts are measured again: others may be chosen for ticks, or be turned."""


@dataclass(frozen=True)
class Surroundings:
    """Room that texts and symbols take outside a panel, CSS pixels."""

    left: float = 0.0
    right: float = 0.0
    above: float = 0.0
    below: float = 0.0

    @classmethod
    def of(cls, axes: Axes) -> Surroundings:
        """As drawn, without the length of titles and labels; none of axes that are not shown.

        What the axes clip is not asked, nor spines: they end where the panel does, and cost as much as all texts.
        """
        beside = [*axes.texts, *axes.child_axes, *filter(None, [axes.get_legend()])]
        whole = axes.get_tightbbox(for_layout_only=True, bbox_extra_artists=beside)
        inside = axes.get_window_extent()
        if whole is None:
            return cls()
        scale = PIXELS_PER_INCH / axes.figure.dpi
        ends = (inside.x0 - whole.x0, whole.x1 - inside.x1, whole.y1 - inside.y1, inside.y0 - whole.y0)
        return cls(*(max(scale * end, 0.0) for end in ends))


def fit_grid(figure: Figure, panels: NDArray[Any], grid: PanelGrid, *, head: float = 0.0) -> PanelGrid:
    """The grid with margins for all texts, after figure and panels were placed by it.

    `head` is the room for title and legend of the whole figure above the panels. Panels keep their height; where labels
    make them much narrower, it is done again. Labels of the first column are then aligned at the edge.
    """
    for _ in range(2):
        for axes in panels.flat:
            _turn_long_ticks(axes)
        width, grid = grid.panel_width, _with_room(panels, grid, head)
        grid.place(figure)
        if grid.panel_width >= NARROWER * width:
            break
    for axes in panels[:, 0]:
        if axes.get_ylabel():
            label_y_axis(axes, axes.get_ylabel())
    return grid


def _with_room(panels: NDArray[Any], grid: PanelGrid, head: float) -> PanelGrid:
    around = [[Surroundings.of(axes) for axes in line] for line in panels]
    rows = [[s.below + t.above for s, t in zip(upper, lower, strict=True)] for upper, lower in pairwise(around)]
    columns = [[s.right + t.left for s, t in pairwise(line)] for line in around]
    between_rows = max((max(row) for row in rows), default=0.0) + GAP
    between_columns = max((max(row, default=0.0) for row in columns), default=0.0) + GAP
    return replace(
        grid,
        left=max(grid.left, max(line[0].left for line in around) + EDGE),
        right=max(grid.right, max(line[-1].right for line in around) + EDGE),
        top=head + max(s.above for s in around[0]) + EDGE,
        bottom=max(s.below for s in around[-1]) + EDGE,
        between_rows=max(between_rows, LEAST_GAP),
        between_columns=max(between_columns, grid.between_columns),
    )


def _turn_long_ticks(axes: Axes) -> None:
    """Turn the names below an axis where they would touch each other or the next panel."""
    if not isinstance(axes.xaxis.get_major_locator(), FixedLocator):
        return
    labels = [label for label in axes.get_xticklabels() if label.get_text() and not label.get_rotation()]
    if not labels:
        return
    boxes = sorted((label.get_window_extent() for label in labels), key=lambda box: box.x0)
    panel: Bbox = axes.get_window_extent()
    tight = any(b.x0 - a.x1 < TICK_GAP for a, b in pairwise(boxes))
    if tight or boxes[-1].x1 > panel.x1:
        axes.tick_params(axis="x", labelrotation=TURN)
        for label in labels:
            label.set(ha="right", rotation_mode="anchor")


def make_room(figure: Figure, drawn: Sequence[Axes]) -> None:
    """Move the axes of a user's figure once, if a text of those drawn is cut off or written over another panel.

    Nothing is done with a layout engine, which does so itself, and where axes were placed by hand.
    """
    gridded = all(axes.get_subplotspec() is not None for axes in figure.axes)
    if figure.get_layout_engine() is None and gridded and _is_crowded(figure, drawn):
        for axes in drawn:
            _turn_long_ticks(axes)
        ConstrainedLayoutEngine().execute(figure)


def _is_crowded(figure: Figure, drawn: Sequence[Axes]) -> bool:
    boxes = {axes: box for axes in figure.axes if (box := axes.get_tightbbox()) is not None}
    page = figure.bbox
    for axes in (axes for axes in drawn if axes in boxes):
        box = boxes[axes]
        if box.x0 < page.x0 or box.y0 < page.y0 or box.x1 > page.x1 or box.y1 > page.y1:
            return True
        if any(box.overlaps(other) for one, other in boxes.items() if one is not axes):
            return True
    return False


LINE_COLUMNS = 500
"""Columns of pixels of a panel, each with two points of a long line."""
LEGEND_LINE, TITLE_LINE, CHARACTER, HANDLE = 15, 20, 5.4, 36
"""CSS pixels: a line of the legend, of titles, a character of the legend, its coloured handle with a gap."""
POINTS_PER_PIXEL = 0.75
MINOR_TICKS = (2, 5)
"""Of each decade: a report with all eight takes an eighth longer to draw."""
PLAIN_EXPONENT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "−0123456789")
_EXPONENT = re.compile("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]{2,}")
DASHES: dict[bool, Any] = {True: (0, (4, 2)), False: "-"}


def matplotlib_figure(chart: Chart) -> Figure:
    """The chart on a figure of its own, as high as its texts need; panels have the height that the chart states."""
    labels = legend_labels(chart.panels) if chart.legend and not chart.panel_legends else []
    lines = _legend_lines(labels, chart.page_width - 2 * EDGE - TITLE_CHARACTER * len(chart.title))
    grid = PanelGrid(
        rows=len(chart.rows),
        columns=chart.columns,
        panel_height=chart.row_height,
        width=chart.page_width,
        left=chart.left,
        right=chart.right,
        between_columns=chart.between_columns or (30 if chart.shared_y else 40),
    )
    shared: dict[str, Any] = {
        "sharex": "col" if chart.shared_x else False,
        "sharey": "row" if chart.shared_y else False,
    }
    figure, places = grid.panels(heights=chart.heights or None, **shared)
    drawn = [
        (axes, _draw_in_grid(axes, panel, chart, (row, column)))
        for row, (panels, line) in enumerate(zip(chart.labelled_rows, places, strict=True))
        for column, (panel, axes) in enumerate(zip(panels, line, strict=True))
        if panel is not None
    ]
    for axes in set(places.flat) - {axes for axes, _ in drawn}:
        axes.set_visible(False)
    head = max(LEGEND_LINE * len(lines), TITLE_LINE * bool(chart.title)) + 4 * bool(lines or chart.title)
    grid = fit_grid(figure, places, grid, head=head)
    for axes, notes in drawn:
        place_notes(axes, notes)
    _head(figure, places.flat, chart, grid, lines)
    return figure


def _draw_in_grid(axes: Axes, panel: Panel, chart: Chart, at: tuple[int, int]) -> list[Note]:
    """A panel of the grid, with its own legend where the chart has one in each."""
    row, column = at
    untitled = takewhile(lambda other: other is None or not other.title, chart.rows[row][column + 1 :])
    notes = draw_panel(axes, panel, title_room=1 + len(list(untitled)))
    if chart.shared_x and row + 1 < len(chart.rows):
        axes.label_outer(remove_inner_ticks=False)
    labels = legend_labels([panel]) if chart.panel_legends else []
    if labels:
        _legend_above(axes, labels, "lower right", (1.0, 1.0))
    return notes


def draw_on(axes: Any, chart: Chart) -> Figure:
    """The chart on a user's axes: its main panel on one, all panels on as many.

    Only where something would be cut off or written over are the axes of the figure moved, unless it has a layout
    engine that does so. Raises InputError for another number of axes, and for what are no axes.
    """
    given = [axes] if isinstance(axes, Axes) else list(np.ravel(np.asarray(axes, dtype=object)))
    if not given or not all(isinstance(a, Axes) for a in given):
        remedy = "give one of matplotlib.pyplot.subplots(), or as many as the figure has panels"
        raise InputError(what=f"ax is {kind_of(axes)}, not axes of matplotlib", where="plot", remedy=remedy)
    panels = (chart.main_panel,) if len(given) == 1 else chart.panels
    if len(given) != len(panels):
        remedy = f"give {len(chart.panels)} axes, or one for the main panel"
        raise InputError(what=f"{len(given)} axes for {len(chart.panels)} panels", where="plot", remedy=remedy)
    notes = [_draw_on_one(place, panel, legend=chart.legend) for place, panel in zip(given, panels, strict=True)]
    figure = cast(Figure, given[0].get_figure(root=True))
    make_room(figure, given)
    for place, written in zip(given, notes, strict=True):
        place_notes(place, written)
    return figure


def _draw_on_one(axes: Axes, panel: Panel, *, legend: bool) -> list[Note]:
    """A panel on axes of a user, its legend above it, where it covers no data."""
    notes = draw_panel(style_axes(axes), panel)
    labels = legend_labels([panel]) if legend else []
    if labels:
        lines = _legend_above(axes, labels, "lower left", (0.0, 1.0))
        pad = 6 + LEGEND_LINE * lines * POINTS_PER_PIXEL
        panel_title(axes, typeset(panel.title), panel.title_colour, pad=pad)
    return notes


def draw_panel(axes: Axes, panel: Panel, *, title_room: float = 1.0) -> list[Note]:
    """The marks of a panel, its labels, scales and limits; its notes, to be placed when the axes have their size.

    The title may be `title_room` times as wide as the axes.
    """
    if panel.x_log:
        axes.set_xscale("log", subs=MINOR_TICKS)
    if panel.y_log:
        axes.set_yscale("log", subs=MINOR_TICKS)
    notes = [note for number, mark in enumerate(panel.drawn) for note in _draw(mark, axes, panel, 0.1 * number)]
    if panel.title:
        panel_title(axes, typeset(panel.title), panel.title_colour, room=title_room)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.x_ticks:
        axes.set_xticks(range(len(panel.x_ticks)), [typeset(tick) for tick in panel.x_ticks])
    if not panel.y_log and not any(isinstance(mark, Bars | Heat) for mark in panel.marks):
        axes.yaxis.set_major_formatter(FuncFormatter(_tick))
    if panel.x_limits:
        axes.set_xlim(*panel.x_limits)
    if panel.y_limits:
        axes.set_ylim(*panel.y_limits)
    if panel.note:
        notes.append(Note.at_first(_annotation(axes, panel.note, (0.995, 0.97), axes.transAxes, color=MUTED), CORNERS))
    return notes


def _annotation(axes: Axes, text: str, at: tuple[float, float], transform: Any, **style: Any) -> Annotation:
    """Small words on a pale ground; `place_notes` says where from there."""
    ground = {"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.6}
    return axes.annotate(
        typeset(text), at, (0, 0), transform, "offset points", bbox=ground, **{"fontsize": SMALL, "zorder": 4} | style
    )


def typeset(text: str) -> str:
    """Text whose exponents of several characters are set by matplotlib: fonts have them in different sizes."""
    if not _EXPONENT.search(text):
        return text
    plain = text.replace("$", r"\$")
    return _EXPONENT.sub(lambda match: f"$^{{\\mathregular{{{match[0].translate(PLAIN_EXPONENT)}}}}}$", plain)


def _tick(value: float, _position: int) -> str:
    """A number of an axis, without an offset elsewhere."""
    return f"{value:.6g}".replace("-", "−")


# ------------------------------------------------------------------------------------------------ legend


def _legend_lines(labels: list[str], width: float) -> list[list[str]]:
    """The labels in lines that fit the width, CSS pixels."""
    lines: list[list[str]] = []
    room = 0.0
    for label in labels:
        size = HANDLE + CHARACTER * len(label)
        if not lines or size > room:
            lines.append([])
            room = width
        lines[-1].append(label)
        room -= size
    return lines


def _head(figure: Figure, panels: Iterable[Axes], chart: Chart, grid: PanelGrid, lines: list[list[str]]) -> None:
    """Title of the figure on the left, and its legend on the right, each line as wide as it is."""
    if chart.title:
        place = {"x": grid.left / grid.width, "y": 1 - EDGE / grid.height}
        figure.suptitle(chart.title, ha="left", va="top", fontsize=NORMAL + 0.5, color=MUTED, **place)
    options: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        options = dict(zip(labels, handles, strict=True)) | options
    for number, line in enumerate(lines):
        down = EDGE + number * LEGEND_LINE
        figure.legend(
            [options[label] for label in line], line, **LEGEND, ncols=len(line), loc="upper right",
            bbox_to_anchor=(1 - EDGE / grid.width, 1 - down / grid.height), borderaxespad=0.0, borderpad=0.0,
        )  # fmt: skip


def _legend_above(axes: Axes, labels: list[str], corner: str, at: tuple[float, float]) -> int:
    """The legend of one panel above it, in columns that fit its width; how many lines it has."""
    handles, names = axes.get_legend_handles_labels()
    handle_of = dict(zip(names, handles, strict=True))
    width = axes.get_window_extent().width * PIXELS_PER_INCH / axes.figure.dpi
    columns = max(1, min(len(labels), int(width / (HANDLE + CHARACTER * max(map(len, labels))))))
    place: dict[str, Any] = {"loc": corner, "bbox_to_anchor": at, "borderaxespad": 0.0, "borderpad": 0.3}
    axes.legend([handle_of[label] for label in labels], labels, ncols=columns, **place, **LEGEND)
    return -(-len(labels) // columns)


# ------------------------------------------------------------------------------------------------- marks


@singledispatch
def _draw(mark: object, axes: Axes, panel: Panel, order: float) -> list[Note]:
    raise TypeError(f"no drawing of {type(mark).__name__}")


@_draw.register
def _line(mark: Line, axes: Axes, panel: Panel, order: float) -> list[Note]:
    x, y = decimated(mark, LINE_COLUMNS, log=panel.x_log)
    axes.plot(
        x, y, color=mark.colour, lw=mark.width, alpha=mark.opacity, ls=DASHES[mark.dashed], zorder=2 + order,
        drawstyle="steps-mid" if mark.steps else "default", label=mark.label or None, solid_joinstyle="round",
    )  # fmt: skip
    return []


@_draw.register
def _points(mark: Points, axes: Axes, panel: Panel, order: float) -> list[Note]:
    mark = thinned(mark, LINE_COLUMNS, log=panel.x_log)
    if mark.low is not None and mark.high is not None:
        axes.vlines(mark.x, mark.low, mark.high, color=mark.colour, lw=1.1, zorder=2 + order)
    face = "white" if mark.hollow else mark.colour
    axes.plot(
        mark.x, mark.y, mark.symbol, ms=mark.size, mfc=face, mec=mark.colour, color=mark.colour,
        mew=1.6 if mark.symbol == "_" else 0.9, zorder=2.05 + order, label=mark.label or None,
    )  # fmt: skip
    return [
        Note.at_first(_annotation(axes, note, (x, y), axes.transData, color=INK), AROUND_POINT)
        for x, y, note in zip(mark.x, mark.y, mark.notes, strict=False)
        if note
    ]


@_draw.register
def _band(mark: Band, axes: Axes, panel: Panel, order: float) -> list[Note]:
    style: dict[str, Any] = {"color": mark.colour, "alpha": mark.opacity, "lw": 0, "label": mark.label or None}
    if mark.x is None:
        axes.axhspan(float(mark.low), float(mark.high), zorder=order / 10, **style)
    elif len(mark.x) <= 2 * LINE_COLUMNS:
        axes.fill_between(mark.x, mark.low, mark.high, zorder=order / 10, **style)
    else:
        low, high = (np.broadcast_to(np.asarray(v, dtype=np.float64), mark.x.shape) for v in (mark.low, mark.high))
        x, bottom = decimated(Line(x=mark.x, y=low, colour=mark.colour), LINE_COLUMNS, log=panel.x_log)
        x_top, top = decimated(Line(x=mark.x, y=high, colour=mark.colour), LINE_COLUMNS, log=panel.x_log)
        axes.fill(np.concatenate([x, x_top[::-1]]), np.concatenate([bottom, top[::-1]]), zorder=order / 10, **style)
    return []


@_draw.register
def _span(mark: Span, axes: Axes, panel: Panel, order: float) -> list[Note]:
    axes.axvspan(
        mark.start, mark.end, color=mark.colour, alpha=mark.opacity, lw=0, zorder=order / 10, label=mark.label or None
    )
    return []


@_draw.register
def _level(mark: Level, axes: Axes, panel: Panel, order: float) -> list[Note]:
    axes.axhline(mark.y, color=mark.colour, lw=0.9 if mark.dashed else 0.5, ls=DASHES[mark.dashed], zorder=1)
    if not mark.note:
        return []
    style = {"color": MUTED, "fontsize": SMALL - 0.5}
    text = _annotation(axes, mark.note, (0.995, mark.y), axes.get_yaxis_transform(), **style)
    return [Note.at_first(text, along_level(mark.y))]


@_draw.register
def _bars(mark: Bars, axes: Axes, panel: Panel, order: float) -> list[Note]:
    count = len(mark.names)
    axes.barh(range(count), mark.sizes, color=list(mark.colours), height=0.66)
    axes.set_yticks(range(count), list(mark.names))
    axes.set_ylim(max(count, 1) - 0.4, -0.6)
    for place, note in enumerate(mark.notes):
        axes.annotate(
            typeset(note), (1.0, place), (4, 0), axes.get_yaxis_transform(), "offset points", va="center",
            fontsize=SMALL, color=INK, annotation_clip=False,
        )  # fmt: skip
    return []


@_draw.register
def _heat(mark: Heat, axes: Axes, panel: Panel, order: float) -> list[Note]:
    count = len(mark.rows)
    left, right = mark.ends
    colours = LinearSegmentedColormap.from_list("heat", list(mark.colours))
    scale = Normalize(*mark.limits, clip=True)
    extent = (left, right, count - 0.5, -0.5)
    axes.imshow(mark.values, aspect="auto", cmap=colours, norm=scale, extent=extent, interpolation="nearest")
    axes.set_yticks(range(count), list(mark.rows))
    axes.tick_params(length=0)
    if mark.columns:
        axes.set_xticks(range(len(mark.columns)), list(mark.columns), rotation=60, ha="right", rotation_mode="anchor")
    bar = axes.inset_axes((1.015, 0.0, 0.012, 1.0))
    shown = axes.figure.colorbar(ScalarMappable(scale, colours), cax=bar)
    shown.outline.set_visible(False)
    bar.tick_params(labelsize=SMALL, colors=MUTED, length=2)
    bar.set_ylabel(mark.scale, fontsize=SMALL, color=MUTED)
    if mark.written:
        _write_values(axes, mark, scale)
    return []


def _write_values(axes: Axes, mark: Heat, scale: Callable[[Any], Any]) -> None:
    """The numbers in their cells, white on dark ones."""
    for (row, column), value in np.ndenumerate(mark.values):
        if np.isfinite(value):
            dark = abs(2 * float(scale(value)) - 1) > 0.6
            text = f"{round(value, 2) + 0.0:.2f}".replace("-", "−")
            axes.text(column, row, text, ha="center", va="center", fontsize=6, color="white" if dark else INK)
