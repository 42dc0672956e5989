"""A chart as figures of Bokeh, to zoom: in a page that a server feeds, lines are thinned to what is on the screen."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from html import escape
from itertools import cycle
from math import ceil, floor, log10
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import RangesUpdate
from bokeh.layouts import column, row
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    DataRange1d,
    FactorRange,
    FixedTicker,
    HoverTool,
    LinearColorMapper,
    PlainText,
    PrintfTickFormatter,
    Range1d,
    Spacer,
    glyphs,
)
from bokeh.models.annotations import Label, Title
from bokeh.models.annotations import Span as Rule
from bokeh.plotting import figure

from truewrench.plots.chart import (
    Array,
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
from truewrench.plots.style import LIGHT, Scheme

LINE_COLUMNS = 1200
"""Columns of pixels for which a line keeps its extremes."""
MARKERS = {"o": "circle", "s": "square", "D": "diamond", "^": "triangle", "v": "inverted_triangle", "P": "plus",
           "X": "x", "_": "dash"}  # fmt: skip
SYMBOLS = {"o": ("●", "○"), "s": ("■", "□"), "D": ("◆", "◇"), "^": ("▲", "△"), "v": ("▼", "▽"), "P": ("✚", "✚"),
           "X": ("✖", "✖"), "_": ("–", "–")}  # fmt: skip
"""The same in a legend: full and hollow."""
TICKS = 5
"""Wanted on an axis: panels are small."""
PLAIN_NUMBERS, ROUNDED_NUMBERS = "%.10g", "%.3g"
"""Ticks of a linear and of a logarithmic axis: as short as they can be written. No script, which a page may forbid."""
FONT = "10.5px"
LEAST = 230
"""CSS pixels of a figure; where they do not fit beside each other they are below."""
LEFT, RIGHT = 80, 12
"""CSS pixels beside a panel, so that panels below each other are aligned."""


@dataclass(frozen=True, eq=False)
class _Series:
    """Lines over one ascending x in one data source: they are thinned alike, and their values are read off together."""

    lines: tuple[Line, ...]
    source: ColumnDataSource

    def show(self, columns: int, inside: slice = slice(None), *, log: bool = False) -> bool:
        """Give the source the samples inside, of many the extremes of each line in so many intervals.

        Returns whether any sample was left out.
        """
        lines = [Line(x=line.x[inside], y=line.y[inside], colour=line.colour) for line in self.lines]
        x = lines[0].x
        index = np.arange(len(x))
        if many := len(x) > 2 * columns * len(lines):
            kept = [decimated(line, columns, log=log)[0] for line in lines]
            index = np.unique(np.searchsorted(x, np.concatenate(kept)))
        data: dict[str, Any] = {"x": x[index], **{f"y{n}": line.y[index] for n, line in enumerate(lines)}}
        self.source.data = data
        return many


def _series_of(panel: Panel) -> list[_Series]:
    """The lines of a panel, those over the same x together."""
    groups: list[list[Line]] = []
    for line in (mark for mark in panel.drawn if isinstance(mark, Line)):
        group = next((g for g in groups if np.array_equal(g[0].x, line.x)), None)
        if group is None:
            groups.append([line])
        else:
            group.append(line)
    return [_Series(tuple(group), ColumnDataSource()) for group in groups]


@dataclass(frozen=True, eq=False)
class _Drawing:
    """A figure under way: its panel and colours, its lines, and its points with their glyphs.

    columns   intervals of a long line, each with its smallest and largest sample
    """

    figure: Any
    panel: Panel
    scheme: Scheme
    columns: int
    series: Sequence[_Series]
    points: list[tuple[Points, Any]] = field(default_factory=list)

    def colour(self, colour: str) -> str:
        return self.scheme.colour(colour)

    def add(self, glyph: Any, source: ColumnDataSource, name: str = "", level: str = "glyph") -> Any:
        """Draw a glyph alone: methods of the figure make three more, for points that are selected or muted.

        They cost a quarter of a page's figures, and nothing can be selected.
        """
        return self.figure.add_glyph(source, glyph, name=name, level=level)


def bokeh_chart(chart: Chart, scheme: Scheme = LIGHT, *, columns: int | None = None) -> Any:
    """The chart as a column of rows of figures, each as wide as its place; shared axes are linked.

    columns   intervals of a long line, each with its smallest and largest sample, for a page that no server feeds; None
              where lines are thinned to what is on the screen
    """
    shared: dict[tuple[str, int], Any] = {}
    lines = []
    for number, panels in enumerate(chart.labelled_rows):
        figures: list[Any] = []
        for place, panel in enumerate(panels):
            named = chart.rows[number][place]
            if panel is None or named is None:
                figures.append(Spacer(sizing_mode="stretch_width"))
                continue
            drawn = _linked_figure(chart, panel, (number, place), shared)
            drawing = _Drawing(drawn, panel, scheme, columns or LINE_COLUMNS, _series_of(panel))
            _draw_panel(drawing, named, served=columns is None)
            if chart.shared_x and not panel.x_label:  # the numbers of the lowest panel are below
                drawn.xaxis.major_label_text_font_size, drawn.xaxis.major_label_text_color = "1px", None
            figures.append(drawn)
        lines.append(row(*figures, sizing_mode="stretch_width", spacing=10, styles={"flex-wrap": "wrap"}))
    return column(*lines, sizing_mode="stretch_width", spacing=4)


def document_item(layout: Any) -> dict[str, Any]:
    """The layout as a document that BokehJS embeds: numbers as a screen can show them, in half the space."""
    document = Document()
    for source in layout.select({"type": ColumnDataSource}):
        source.data = {name: _single_precision(values) for name, values in source.data.items()}
    document.add_root(layout)
    return {"doc": document.to_json(deferred=False), "root_id": layout.id}


def _single_precision(values: Any) -> Any:
    return values.astype(np.float32) if isinstance(values, np.ndarray) and values.dtype == np.float64 else values


def legend_html(chart: Chart, scheme: Scheme = LIGHT) -> str:
    """The legend of a chart: each label once, with its colour and kind; empty without labels.

    Where each panel has a legend of its own, a line for each, headed by the name of its y axis.
    """
    if not chart.legend:
        return ""
    if chart.panel_legends:
        return "".join(_legend_list([panel], scheme, panel.y_label) for panel in chart.panels)
    return _legend_list(chart.panels, scheme)


def _legend_list(panels: Sequence[Panel], scheme: Scheme, head: str = "") -> str:
    entries: dict[str, str] = {}
    for mark in (mark for panel in panels for mark in panel.drawn):
        if label := _entry(mark):
            entries.setdefault(label, _key(mark, scheme))
    order = legend_labels(panels)
    ordered = sorted(entries, key=lambda label: order.index(label) if label in order else len(order))
    items = [f'<li data-label="{escape(label)}">{entries[label]}{escape(label)}</li>' for label in ordered]
    named = f"<li>{escape(head)}:</li>" if head else ""
    return f'<ul class="legend">{named}{"".join(items)}</ul>' if items else ""


def _entry(mark: Any) -> str:
    return str(mark.note if isinstance(mark, Level) else getattr(mark, "label", ""))


def _key(mark: Any, scheme: Scheme) -> str:
    """A line, point or area of the mark's colour."""
    colour = scheme.colour(mark.colour)
    if isinstance(mark, Line | Level):
        width, opacity = (mark.width, mark.opacity) if isinstance(mark, Line) else (1.5, 1.0)
        style = f"border-top: {max(width, 1.0):g}px {'dashed' if mark.dashed else 'solid'} {colour}"
        return f'<i class="line-key" style="{style}; opacity: {opacity:g}"></i>'
    if isinstance(mark, Points):
        full, hollow = SYMBOLS.get(mark.symbol, SYMBOLS["o"])
        return f'<i class="point-key" style="color: {colour}">{hollow if mark.hollow else full}</i>'
    opacity = max(mark.opacity, 0.4)
    return f'<i class="area-key" style="background: {colour}; opacity: {opacity:g}"></i>'


def figures_of(layout: Any) -> list[figure]:
    """The figures of a layout, row by row."""
    return [drawn for line in layout.children for drawn in line.children if isinstance(drawn, figure)]


def _linked_figure(chart: Chart, panel: Panel, at: tuple[int, int], shared: dict[tuple[str, int], Any]) -> figure:
    """An empty figure with axes of the panel, those that are shared as in the figures before."""
    number, place = at
    share = chart.heights[number] * len(chart.heights) / sum(chart.heights) if chart.heights else 1.0
    height = chart.row_height * share + 14 + 26 * bool(panel.x_label) + 18 * _has_title(chart, number)
    names = [name for mark in panel.marks if isinstance(mark, Bars) for name in mark.names]
    rows = [name for mark in panel.marks if isinstance(mark, Heat) for name in mark.rows]
    ordered = FactorRange(factors=list(reversed(names or rows))) if names or rows else None
    x_range = shared.get(("x", place)) if chart.shared_x else None
    y_range = shared.get(("y", number)) if chart.shared_y else None
    options: dict[str, Any] = {
        "x_axis_type": "log" if panel.x_log else "linear", "y_axis_type": "log" if panel.y_log else "linear",
        "x_range": x_range or _range(panel.x_limits), "y_range": y_range or ordered or _range(panel.y_limits),
        "tools": "xbox_zoom,box_zoom,xpan,xwheel_zoom,reset,save", "active_drag": "xbox_zoom", "active_scroll": None,
        "toolbar_location": "right", "min_border_left": LEFT, "min_border_right": RIGHT,
    }  # fmt: skip
    drawn = figure(height=int(height), sizing_mode="stretch_width", min_width=LEAST, **options)
    shared.setdefault(("x", place), drawn.x_range)
    shared.setdefault(("y", number), drawn.y_range)
    return drawn


def _has_title(chart: Chart, row_number: int) -> bool:
    return any(panel is not None and panel.title for panel in chart.rows[row_number])


def _draw_panel(drawing: _Drawing, named: Panel, *, served: bool) -> None:
    """Marks and labels of a panel; `named` is the panel with the labels of shared axes too, which the mouse shows."""
    long = [series for series in drawing.series if series.show(drawing.columns, log=drawing.panel.x_log)]
    for mark in drawing.panel.drawn:
        _draw(mark, drawing)
    _label(drawing)
    _add_hover(drawing, named)
    if served and long and not drawing.panel.x_log:
        drawing.figure.on_event(RangesUpdate, lambda event: _thin_again(long, event.x0, event.x1))


def _thin_again(long: Sequence[_Series], start: float, end: float) -> None:
    """The extremes of what is between two values of x, one sample beyond each."""
    for series in long:
        first, last = np.searchsorted(series.lines[0].x, (start, end))
        inside = slice(max(int(first) - 1, 0), int(last) + 1)
        if len(series.lines[0].x[inside]) > 1:
            series.show(LINE_COLUMNS, inside)


def _add_hover(drawing: _Drawing, named: Panel) -> None:
    """What is under the mouse says its values with their units: lines wherever the mouse is above or below them."""
    across = [] if named.x_ticks else [(named.x_label or "x", "@x{%.5g}")]
    in_brackets = re.search(r" \(([^()]*)\)$", named.y_label)
    unit = f" {in_brackets[1]}" if in_brackets else ""
    written: Any = dict.fromkeys(("@x", "@y", "@low", "@high", *(f"@y{n}" for n in range(len(named.marks)))), "printf")
    sides: Any = cycle(("right", "left"))
    for series, side in zip(drawing.series, sides, strict=False):
        values = [(line.label, f"@y{n}{{%.5g}}{unit}") for n, line in enumerate(series.lines) if line.label]
        if values:
            unseen = drawing.add(glyphs.Line(x="x", y="y0", line_alpha=0.0), series.source)  # no legend hides it
            drawing.figure.add_tools(
                HoverTool(renderers=[unseen], tooltips=[*across, *values], formatters=written, visible=False,
                          mode="vline", attachment=side)
            )  # fmt: skip
    for points, drawn in drawing.points:
        value = [*across, (points.label or named.y_label or "y", f"@y{{%.5g}}{unit}")]
        interval = [(points.interval, f"@low{{%.4g}} to @high{{%.4g}}{unit}")] if points.interval else []
        drawing.figure.add_tools(
            HoverTool(renderers=[drawn], tooltips=[*value, *interval], formatters=written, visible=False)
        )


def _range(limits: tuple[float, float] | None) -> Any:
    return DataRange1d() if limits is None else Range1d(start=limits[0], end=limits[1])


def _label(drawing: _Drawing) -> None:
    """Title, names of axes, ticks and colours."""
    drawn, panel, scheme = drawing.figure, drawing.panel, drawing.scheme
    if panel.title:
        drawn.add_layout(
            Title(text=panel.title, text_color=scheme.colour(panel.title_colour), text_font_size="12.5px"), "above"
        )
    for axis, label in ((drawn.xaxis, panel.x_label), (drawn.yaxis, panel.y_label)):
        axis.axis_label = PlainText(text=label) if label else None  # a user's column may be called like a formula
    drawn.background_fill_color = drawn.border_fill_color = scheme.paper
    drawn.outline_line_color = None
    drawn.toolbar.logo = None
    drawn.toolbar.autohide = True
    for axis in (*drawn.xaxis, *drawn.yaxis):
        axis.axis_label_text_color, axis.major_label_text_color = scheme.ink, scheme.muted
        axis.axis_label_text_font_style, axis.axis_label_text_font_size = "normal", "11.5px"
        axis.major_label_text_font_size = FONT
        axis.axis_line_color = axis.major_tick_line_color = scheme.muted
        axis.minor_tick_line_color = None
    drawn.grid.grid_line_color = scheme.grid
    _place_ticks(drawn.xaxis, panel.x_limits, log=panel.x_log)
    _place_ticks(drawn.yaxis, panel.y_limits, log=panel.y_log)
    if panel.x_ticks:
        drawn.xaxis.ticker = list(range(len(panel.x_ticks)))
        drawn.xaxis.major_label_overrides = dict(enumerate(panel.x_ticks))
    if panel.note:
        place: dict[str, Any] = {"x_units": "screen", "y_units": "screen", "x": 6, "y": 4}
        drawn.add_layout(Label(text=panel.note, text_color=scheme.muted, text_font_size=FONT, **place))


def _place_ticks(axis: Any, limits: tuple[float, float] | None, *, log: bool) -> None:
    """Few ticks, as panels are small, plainly written."""
    if log and limits is not None:
        axis.ticker = FixedTicker(ticks=log_ticks(*limits))
        axis.formatter = PrintfTickFormatter(format=ROUNDED_NUMBERS)
    elif not log and isinstance(axis[0].ticker, BasicTicker):
        axis.ticker.desired_num_ticks = TICKS
        axis.formatter = PrintfTickFormatter(format=PLAIN_NUMBERS)


def log_ticks(low: float, high: float) -> list[float]:
    """Ticks of a logarithmic axis, and as many beyond both ends for who moves it: 1, 2, 5 where it spans little."""
    decades = log10(high / low)
    mantissas = (1, 2, 5) if decades < 1.5 else (1, 3) if decades < 2.5 else (1,)
    step = ceil(decades / TICKS)
    first, last = floor(log10(low)), ceil(log10(high))
    exponents = range(first - first % step - 2 * step, last + 2 * step + 1, step)
    return [m * 10.0**e for e in exponents for m in mantissas]


# ------------------------------------------------------------------------------------------------- marks


@singledispatch
def _draw(mark: object, drawing: _Drawing) -> None:
    raise TypeError(f"no drawing of {type(mark).__name__}")


@_draw.register
def _line(mark: Line, drawing: _Drawing) -> None:
    series = next(s for s in drawing.series if mark in s.lines)
    style: dict[str, Any] = {
        "x": "x", "y": f"y{series.lines.index(mark)}", "line_color": drawing.colour(mark.colour),
        "line_width": mark.width, "line_alpha": mark.opacity, "line_dash": "dashed" if mark.dashed else "solid",
    }  # fmt: skip
    glyph = glyphs.Step(mode="center", **style) if mark.steps else glyphs.Line(**style)
    drawing.add(glyph, series.source, mark.label)


@_draw.register
def _points(mark: Points, drawing: _Drawing) -> None:
    mark = thinned(mark, drawing.columns, log=drawing.panel.x_log)
    colour = drawing.colour(mark.colour)
    values: dict[str, Any] = {"x": mark.x, "y": mark.y}
    bars = mark.low is not None and mark.high is not None
    source = ColumnDataSource(values | ({"low": mark.low, "high": mark.high} if bars else {}))
    if bars:
        segment = glyphs.Segment(x0="x", y0="low", x1="x", y1="high", line_color=colour, line_width=1.3)
        drawing.add(segment, source, mark.label)
    marker = glyphs.Scatter(
        x="x", y="y", marker=MARKERS.get(mark.symbol, "circle"), size=1.6 * mark.size, line_color=colour,
        fill_color=drawing.scheme.paper if mark.hollow else colour, line_width=1.4,
    )  # fmt: skip
    drawing.points.append((mark, drawing.add(marker, source, mark.label)))
    if mark.notes:
        drawing.figure.text(
            mark.x, mark.y, text=list(mark.notes), x_offset=-7, y_offset=-6, text_align="right",
            text_font_size=FONT, text_color=drawing.scheme.ink, name=mark.label,
        )  # fmt: skip


@_draw.register
def _band(mark: Band, drawing: _Drawing) -> None:
    style: dict[str, Any] = {"fill_color": drawing.colour(mark.colour), "fill_alpha": mark.opacity, "line_color": None}
    if mark.x is None:
        limits: dict[str, Any] = {"y0": [float(np.asarray(mark.low))], "y1": [float(np.asarray(mark.high))]}
        strip = glyphs.HStrip(y0="y0", y1="y1", **style)
        drawing.add(strip, ColumnDataSource(limits), mark.label, "underlay")
        return
    low, high = (np.broadcast_to(np.asarray(v, dtype=np.float64), mark.x.shape) for v in (mark.low, mark.high))
    log, columns = drawing.panel.x_log, drawing.columns
    x, bottom = decimated(Line(x=mark.x, y=low, colour=mark.colour), columns, log=log)
    x_top, top = decimated(Line(x=mark.x, y=high, colour=mark.colour), columns, log=log)
    outline: Array = np.concatenate([bottom, top[::-1]])
    source = ColumnDataSource({"x": np.concatenate([x, x_top[::-1]]), "y": outline})
    drawing.add(glyphs.Patch(x="x", y="y", **style), source, mark.label)


@_draw.register
def _span(mark: Span, drawing: _Drawing) -> None:
    style: dict[str, Any] = {"fill_color": drawing.colour(mark.colour), "fill_alpha": mark.opacity, "line_color": None}
    source = ColumnDataSource({"x0": [mark.start], "x1": [mark.end]})
    drawing.add(glyphs.VStrip(x0="x0", x1="x1", **style), source, mark.label, "underlay")


@_draw.register
def _level(mark: Level, drawing: _Drawing) -> None:
    drawing.figure.add_layout(
        Rule(
            location=mark.y, dimension="width", line_color=drawing.colour(mark.colour), line_width=1,
            line_dash="dashed" if mark.dashed else "solid", name=mark.note,
        )
    )  # fmt: skip


@_draw.register
def _bars(mark: Bars, drawing: _Drawing) -> None:
    data: dict[str, Any] = {"name": list(mark.names), "size": list(mark.sizes), "note": list(mark.notes)}
    source = ColumnDataSource(data | {"colour": [drawing.colour(c) for c in mark.colours]})
    drawing.figure.hbar(y="name", right="size", height=0.7, fill_color="colour", line_color=None, source=source)
    drawing.figure.text(
        x="size", y="name", text="note", x_offset=5, text_baseline="middle", text_font_size=FONT,
        text_color=drawing.scheme.ink, source=source,
    )  # fmt: skip


@_draw.register
def _heat(mark: Heat, drawing: _Drawing) -> None:
    across = np.arange(mark.values.shape[1], dtype=float) if mark.x is None else mark.x
    low, high = mark.ends
    x, y = np.meshgrid(across, np.arange(len(mark.rows)))
    source = ColumnDataSource({"x": x.ravel(), "y": [mark.rows[i] for i in y.ravel()], "value": mark.values.ravel()})
    mapper = LinearColorMapper(palette=list(mark.colours), low=mark.limits[0], high=mark.limits[1])
    width = (high - low) / max(len(across), 1)
    drawing.figure.rect(
        x="x", y="y", width=width, height=1.0, fill_color={"field": "value", "transform": mapper}, line_color=None,
        source=source,
    )  # fmt: skip
    drawing.figure.add_tools(HoverTool(tooltips=[(escape(mark.scale), "@value{0.000}")]))
    if mark.columns:
        drawing.figure.xaxis.ticker = list(range(len(mark.columns)))
        drawing.figure.xaxis.major_label_overrides = dict(enumerate(mark.columns))
        drawing.figure.xaxis.major_label_orientation = 1.0
