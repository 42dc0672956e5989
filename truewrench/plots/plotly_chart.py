"""A chart drawn by plotly, for zooming and reading values off."""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

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
)
from truewrench.plots.style import FAINT, INK, MUTED, WIDTH, wrapped

LINE_COLUMNS = 2000
"""Intervals of a long line, each with its smallest and largest sample: several times a screen, so that one can zoom."""
SYMBOLS = {"o": "circle", "_": "line-ew-open", "v": "triangle-down", "s": "square", "D": "diamond", "^": "triangle-up"}
FONT = "-apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'Liberation Sans', sans-serif"
HEAD, FOOT, LEGEND_LINE, LEGEND_ENTRIES = 58, 56, 20, 5
"""CSS pixels above and below the panels, and of a line of the legend, with about so many entries."""
EVERY = {"exclude_empty_subplots": False}
"""A region is drawn before the first line of its panel."""
AXIS: dict[str, Any] = {
    "exponentformat": "power",
    "showgrid": False,
    "showline": True,
    "linecolor": FAINT,
    "ticks": "outside",
    "tickcolor": FAINT,
    "zeroline": False,
}
TITLE_LINE = 17
"""CSS pixels of a further line of a panel's title."""
PANEL_SCALE = 1.5
"""Of a panel's height: a screen has more room than a page."""


def plotly_figure(chart: Chart) -> go.Figure:
    """The chart as an interactive figure."""
    rows, height = len(chart.rows), PANEL_SCALE * chart.row_height
    labels = legend_labels(chart.panels) if not chart.panel_legends else []
    titles = [wrapped(panel.title, _title_width(chart)) for panel in chart.panels]
    more_lines = TITLE_LINE * max(title.count("\n") for title in titles)
    head = HEAD + LEGEND_LINE * -(-len(labels) // LEGEND_ENTRIES) + 20 * bool(chart.title) + more_lines
    between = 30 + PANEL_SCALE * chart.between_rows + more_lines
    inside = rows * height + (rows - 1) * between
    figure = make_subplots(
        rows=rows,
        cols=chart.columns,
        row_heights=list(chart.heights) or None,
        shared_xaxes="columns" if chart.shared_x else False,
        shared_yaxes="rows" if chart.shared_y else False,
        vertical_spacing=between / inside if rows > 1 else 0,
        horizontal_spacing=(0.05 if chart.shared_y else 0.075) if chart.columns > 1 else 0,
        specs=[[None if panel is None else {} for panel in line] for line in chart.rows],
    )
    known: set[str] = set()
    for row, line in enumerate(chart.labelled_rows, 1):
        for column, panel in enumerate(line, 1):
            if panel is not None:
                titled = replace(panel, title=wrapped(panel.title, _title_width(chart)))
                _draw_panel(figure, titled, row, column, set() if chart.panel_legends else known)
                if chart.panel_legends:
                    _own_legend(figure, row, column)
    for trace in figure.data if labels else ():
        trace.legendrank = 1 + labels.index(trace.name) if trace.name in labels else None
    left = max([70, *(7 * len(n) + 24 for p in chart.panels for n in _long_names(p))])
    right = max([20, *(7 * len(n) + 12 for p in chart.panels for m in p.marks if isinstance(m, Bars) for n in m.notes)])
    figure.update_layout(
        height=inside + head + FOOT,
        width=chart.width if chart.columns > 1 else max(chart.width or 0, 0.75 * WIDTH),
        margin={"l": left, "r": 90 if _scales(chart) else right, "t": head, "b": FOOT + _longest_column(chart)},
        title={"text": chart.title, "x": 0.01, "y": 0.99, "yanchor": "top", "font": {"size": 15}},
        font={"family": FONT, "size": 12, "color": INK},
        plot_bgcolor="white",
        paper_bgcolor="white",
        hovermode="closest",
        showlegend=chart.legend,
    )  # fmt: skip
    if not chart.panel_legends:
        above = {"x": 1, "xanchor": "right", "y": 1 + (24 + more_lines) / inside, "yanchor": "bottom"}
        figure.update_layout(legend={"orientation": "h", **above})
    figure.update_xaxes(**AXIS)
    figure.update_yaxes(**AXIS)
    return figure


def _title_width(chart: Chart) -> float:
    """CSS pixels that a panel's title may take."""
    return (chart.page_width - chart.left) / max(sum(p is not None and bool(p.title) for p in chart.rows[0]), 1)


def _own_legend(figure: go.Figure, row: int, column: int) -> None:
    """A legend right above the panel of its traces, the last ones drawn."""
    panel: Any = figure.get_subplot(row, column)
    axis = panel.yaxis.plotly_name.replace("yaxis", "y")
    name = f"legend{row if row > 1 else ''}"
    for trace in figure.data:
        if (trace.yaxis or "y") == axis:
            trace.legend = name
    place = {"x": 1, "xanchor": "right", "y": panel.yaxis.domain[1], "yanchor": "bottom"}
    figure.update_layout({name: {"orientation": "h", **place}})


def _long_names(panel: Panel) -> list[str]:
    """Names of bars and of rows, which stand left of the panel."""
    bars = [name for mark in panel.marks if isinstance(mark, Bars) for name in mark.names]
    return bars + [name for mark in panel.marks if isinstance(mark, Heat) for name in mark.rows]


def _scales(chart: Chart) -> bool:
    return any(isinstance(m, Heat) for p in chart.panels for m in p.marks)


def _longest_column(chart: Chart) -> float:
    """CSS pixels for the names below a heat map, which are turned."""
    return max([0, *(5.5 * len(n) for p in chart.panels for m in p.marks if isinstance(m, Heat) for n in m.columns)])


def _draw_panel(figure: go.Figure, panel: Panel, row: int, column: int, known: set[str]) -> None:
    place = {"row": row, "col": column}
    for mark in panel.drawn:
        _draw(mark, figure, panel, place, known)
    x: dict[str, Any] = {"title": {"text": panel.x_label, "standoff": 6}, "type": "log" if panel.x_log else "linear"}
    y: dict[str, Any] = {"title": {"text": panel.y_label, "standoff": 6}, "type": "log" if panel.y_log else "linear"}
    if panel.x_ticks:
        x |= {
            "tickvals": list(range(len(panel.x_ticks))),
            "ticktext": [_html(t) for t in panel.x_ticks],
            "tickangle": 0,
        }
    if any(isinstance(m, Heat | Bars) for m in panel.marks):
        del y["type"]
    if any(isinstance(m, Heat) for m in panel.marks):
        del x["type"]
    figure.update_xaxes(**x, **_range(panel.x_limits, panel.x_log), **place, showticklabels=True)
    figure.update_yaxes(**y, **_range(panel.y_limits, panel.y_log), **place, showticklabels=True)
    _write(figure, place, panel.title, panel.title_colour, {"x": 0, "y": 1, "xanchor": "left", "yanchor": "bottom"})
    _write(figure, place, panel.note, MUTED, {"x": 1, "y": 1, "xanchor": "right", "yanchor": "top"})


def _html(text: str) -> str:
    return text.replace("\n", "<br>")


def _range(limits: tuple[float, float] | None, log: bool) -> dict[str, Any]:
    if limits is None:
        return {}
    return {"range": [float(np.log10(v)) for v in limits] if log else list(limits)}


def _write(figure: go.Figure, place: dict[str, int], text: str, colour: str, at: dict[str, Any]) -> None:
    """Words in the coordinates of a panel."""
    if text:
        font = {"color": colour, "size": 12 if at["yanchor"] == "top" else 13}
        style = {"showarrow": False, "font": font, "align": at["xanchor"]}
        figure.add_annotation(text=_html(text), xref="x domain", yref="y domain", **at, **style, **place)


def _legend(label: str, known: set[str]) -> dict[str, Any]:
    """Name and group of a trace: each label once in the legend."""
    first = bool(label) and label not in known
    known.add(label)
    return {"name": label, "legendgroup": label or None, "showlegend": first}


def _faded(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


# ------------------------------------------------------------------------------------------------- marks


@singledispatch
def _draw(mark: object, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    raise TypeError(f"no drawing of {type(mark).__name__}")


@_draw.register
def _line(mark: Line, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    x, y = decimated(mark, LINE_COLUMNS, log=panel.x_log)
    style = {
        "color": mark.colour,
        "width": mark.width,
        "dash": "dash" if mark.dashed else "solid",
        "shape": "hvh" if mark.steps else "linear",
    }
    trace = go.Scatter(x=x, y=y, mode="lines", line=style, opacity=mark.opacity, **_legend(mark.label, known))
    figure.add_trace(trace, **place)


@_draw.register
def _points(mark: Points, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    marker: dict[str, Any] = {"color": "white" if mark.hollow else mark.colour, "size": 1.5 * mark.size}
    marker |= {"symbol": SYMBOLS.get(mark.symbol, "circle"), "line": {"color": mark.colour, "width": 1.2}}
    written = bool(mark.notes)
    trace = go.Scatter(
        x=mark.x,
        y=mark.y,
        mode="markers+text" if written else "markers",
        marker=marker,
        text=list(mark.notes) if written else None,
        textposition="middle left",
        textfont={"size": 11},
        error_y=_errors(mark),
        cliponaxis=False,
        **_legend(mark.label, known),
    )
    figure.add_trace(trace, **place)


def _errors(mark: Points) -> dict[str, Any] | None:
    if mark.low is None or mark.high is None:
        return None
    ends = {"array": mark.high - mark.y, "arrayminus": mark.y - mark.low}
    return {"type": "data", "symmetric": False, "color": mark.colour, "thickness": 1.3, "width": 0, **ends}


@_draw.register
def _band(mark: Band, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    fill = _faded(mark.colour, mark.opacity)
    if mark.x is None:
        figure.add_hrect(y0=mark.low, y1=mark.high, fillcolor=fill, line_width=0, layer="below", **place, **EVERY)
        _key(figure, mark.label, mark.colour, place, known)
        return
    low, high = (np.broadcast_to(np.asarray(v, dtype=np.float64), mark.x.shape) for v in (mark.low, mark.high))
    x, bottom = decimated(Line(x=mark.x, y=low, colour=mark.colour), LINE_COLUMNS, log=panel.x_log)
    x_top, top = decimated(Line(x=mark.x, y=high, colour=mark.colour), LINE_COLUMNS, log=panel.x_log)
    outline: Array = np.concatenate([bottom, top[::-1]])
    shape = {"fill": "toself", "fillcolor": fill, "line": {"width": 0}, "mode": "lines", "hoverinfo": "skip"}
    trace = go.Scatter(x=np.concatenate([x, x_top[::-1]]), y=outline, **shape, **_legend(mark.label, known))
    figure.add_trace(trace, **place)


def _key(figure: go.Figure, label: str, colour: str, place: dict[str, int], known: set[str]) -> None:
    """An entry of the legend for what is no trace."""
    if label and label not in known:
        marker = {"symbol": "square", "size": 12, "color": colour}
        figure.add_trace(
            go.Scatter(x=[None], y=[None], mode="markers", marker=marker, **_legend(label, known)), **place
        )


@_draw.register
def _span(mark: Span, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    fill = _faded(mark.colour, mark.opacity)
    figure.add_vrect(x0=mark.start, x1=mark.end, fillcolor=fill, line_width=0, layer="below", **place, **EVERY)
    _key(figure, mark.label, mark.colour, place, known)


@_draw.register
def _level(mark: Level, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    style = {"color": mark.colour, "width": 1.0, "dash": "dash" if mark.dashed else "solid"}
    figure.add_shape(type="line", x0=0, x1=1, xref="x domain", y0=mark.y, y1=mark.y, line=style, layer="below", **place)
    if mark.note:
        at = float(np.log10(mark.y)) if panel.y_log else mark.y
        words = {"text": mark.note, "font": {"size": 10, "color": MUTED}, "showarrow": False}
        figure.add_annotation(x=1, xref="x domain", y=at, xanchor="right", yanchor="bottom", **words, **place)


@_draw.register
def _bars(mark: Bars, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    trace = go.Bar(
        x=list(mark.sizes),
        y=list(mark.names),
        orientation="h",
        marker={"color": list(mark.colours)},
        customdata=list(mark.notes),
        hovertemplate="%{y}: %{x:.3g}, %{customdata}<extra></extra>",
        showlegend=False,
    )
    figure.add_trace(trace, **place)
    figure.update_yaxes(autorange="reversed", type="category", **place)
    for name, note in zip(mark.names, mark.notes, strict=True):
        words = {"text": note, "font": {"size": 11}, "showarrow": False}
        figure.add_annotation(x=1.0, xref="x domain", y=name, xanchor="left", **words, **place)


@_draw.register
def _heat(mark: Heat, figure: go.Figure, panel: Panel, place: dict[str, int], known: set[str]) -> None:
    across: Any = list(mark.columns) if mark.x is None else mark.x
    bar = {"title": {"text": mark.scale, "side": "right"}, "thickness": 12, **_beside(figure, place)}
    trace = go.Heatmap(
        z=mark.values,
        x=across,
        y=list(mark.rows),
        zmin=mark.limits[0],
        zmax=mark.limits[1],
        colorscale=[[i / (len(mark.colours) - 1), colour] for i, colour in enumerate(mark.colours)],
        colorbar=bar,
        texttemplate="%{z:.2f}" if mark.written else None,
        textfont={"size": 10},
        hovertemplate="%{y}, %{x}: %{z:.3g}<extra></extra>",
    )
    figure.add_trace(trace, **place)
    figure.update_yaxes(autorange="reversed", type="category", **place)


def _beside(figure: go.Figure, place: dict[str, int]) -> dict[str, Any]:
    """Place and length of a colour scale beside its panel."""
    panel: Any = figure.get_subplot(place["row"], place["col"])
    low, high = panel.yaxis.domain
    return {"y": (low + high) / 2, "len": max(high - low, 0.05), "yanchor": "middle"}
