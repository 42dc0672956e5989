"""A chart drawn by matplotlib: on a figure of its own, or on a user's axes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import singledispatch
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from modeling.errors import InputError, kind_of
from truewrench.plots.charts.chart import Band, Bars, Chart, Heat, Level, Line, Panel, Points, Span, legend_labels
from truewrench.plots.charts.line_decimation import decimated
from truewrench.plots.style import INK, LEGEND, MUTED, SMALL, WIDTH, PanelGrid, label_y_axis, panel_title, style_axes

LINE_COLUMNS = 500
"""Columns of pixels of a panel, each with two points of a long line."""
LEGEND_LINE, TITLE_LINE, CHARACTER, HANDLE = 15, 20, 4.9, 34
"""CSS pixels: a line of the legend, of titles, a character of the legend, its coloured handle with a gap."""
DASHES: dict[bool, Any] = {True: (0, (4, 2)), False: "-"}


def matplotlib_figure(chart: Chart) -> Figure:
    """The chart on a figure of its own."""
    labels = legend_labels(chart.panels) if chart.legend else []
    width = chart.width or (WIDTH if chart.columns > 1 else 0.62 * WIDTH)
    lines = _legend_lines(labels, width - chart.left - chart.right)
    headed = any(panel is not None and panel.title for panel in chart.rows[0])
    top = 8 + LEGEND_LINE * len(lines) + TITLE_LINE * (headed + bool(chart.title))
    sheet = PanelGrid(
        rows=len(chart.rows),
        columns=chart.columns,
        panel_height=chart.row_height,
        width=width,
        left=chart.left,
        right=chart.right,
        top=top,
        bottom=chart.bottom,
        between_rows=chart.between_rows,
        between_columns=chart.between_columns or (30 if chart.shared_y else 62),
    )
    shared = {"sharex": "col" if chart.shared_x else False, "sharey": "row" if chart.shared_y else False}
    figure, places = sheet.panels(heights=chart.heights or None, **shared)
    for row, (panels, line) in enumerate(zip(chart.labelled_rows, places, strict=True)):
        for column, (panel, axes) in enumerate(zip(panels, line, strict=True)):
            if panel is None:
                axes.set_visible(False)
                continue
            draw_panel(axes, panel)
            if panel.y_label and column == 0:
                label_y_axis(axes, panel.y_label)
            axes.label_outer(remove_inner_ticks=False) if chart.shared_x and row + 1 < len(chart.rows) else None
    if chart.title:
        figure.suptitle(chart.title, x=chart.left / width, y=1 - 4 / sheet.height, ha="left", va="top", fontsize=10)
    if lines:
        at = (1 - chart.right / width, 1 - (4 + TITLE_LINE * bool(chart.title)) / sheet.height)
        _legend(figure, places.flat, lines, at)
    return figure


def draw_on(axes: Any, chart: Chart) -> Figure:
    """The chart on a user's axes: its main panel on one, all panels on as many.

    Raises InputError for another number of axes, and for what are no axes.
    """
    given = [axes] if isinstance(axes, Axes) else list(np.ravel(np.asarray(axes, dtype=object)))
    if not given or not all(isinstance(a, Axes) for a in given):
        remedy = "give one of matplotlib.pyplot.subplots(), or as many as the figure has panels"
        raise InputError(what=f"ax is {kind_of(axes)}, not axes of matplotlib", where="plot", remedy=remedy)
    panels = (chart.main_panel,) if len(given) == 1 else chart.panels
    if len(given) != len(panels):
        remedy = f"give {len(chart.panels)} axes, or one for the main panel"
        raise InputError(what=f"{len(given)} axes for {len(chart.panels)} panels", where="plot", remedy=remedy)
    for place, panel in zip(given, panels, strict=True):
        draw_panel(style_axes(place), panel)
        if legend_labels([panel]) and chart.legend:
            place.legend(**LEGEND)
    return cast(Figure, given[0].get_figure(root=True))


def draw_panel(axes: Axes, panel: Panel) -> None:
    """The marks of a panel, its labels, scales and limits."""
    if panel.x_log:
        axes.set_xscale("log")
    if panel.y_log:
        axes.set_yscale("log")
    for number, mark in enumerate(panel.marks):
        _draw(mark, axes, panel, 0.1 * number)
    if panel.title:
        panel_title(axes, panel.title, panel.title_colour)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.x_ticks:
        axes.set_xticks(range(len(panel.x_ticks)), list(panel.x_ticks))
    if not panel.y_log and not any(isinstance(mark, Bars | Heat) for mark in panel.marks):
        axes.yaxis.set_major_formatter(FuncFormatter(_tick))
    if panel.x_limits:
        axes.set_xlim(*panel.x_limits)
    if panel.y_limits:
        axes.set_ylim(*panel.y_limits)
    if panel.note:
        axes.text(0.995, 0.95, panel.note, transform=axes.transAxes, ha="right", va="top", fontsize=SMALL, color=MUTED)


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


def _legend(figure: Figure, panels: Iterable[Axes], lines: list[list[str]], at: tuple[float, float]) -> None:
    """A line of the legend below the other, each as wide as it is."""
    known: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        known = dict(zip(labels, handles, strict=True)) | known
    height = float(figure.get_figheight()) * 96
    for number, line in enumerate(lines):
        place = (at[0], at[1] - number * LEGEND_LINE / height)
        shown = [label for label in line if label in known]
        figure.legend(
            [known[label] for label in shown], shown, **LEGEND, ncols=len(line), loc="upper right",
            bbox_to_anchor=place, borderaxespad=0.0, borderpad=0.0,
        )  # fmt: skip


# ------------------------------------------------------------------------------------------------- marks


@singledispatch
def _draw(mark: object, axes: Axes, panel: Panel, order: float) -> None:
    raise TypeError(f"no drawing of {type(mark).__name__}")


@_draw.register
def _line(mark: Line, axes: Axes, panel: Panel, order: float) -> None:
    x, y = decimated(mark, LINE_COLUMNS, log=panel.x_log)
    axes.plot(
        x, y, color=mark.colour, lw=mark.width, alpha=mark.opacity, ls=DASHES[mark.dashed], zorder=2 + order,
        drawstyle="steps-mid" if mark.steps else "default", label=mark.label or None, solid_joinstyle="round",
    )  # fmt: skip


@_draw.register
def _points(mark: Points, axes: Axes, panel: Panel, order: float) -> None:
    if mark.low is not None and mark.high is not None:
        axes.vlines(mark.x, mark.low, mark.high, color=mark.colour, lw=1.1, zorder=2 + order)
    face = "white" if mark.hollow else mark.colour
    axes.plot(
        mark.x, mark.y, mark.symbol, ms=mark.size, mfc=face, mec=mark.colour, color=mark.colour,
        mew=1.6 if mark.symbol == "_" else 0.9, zorder=2.05 + order, label=mark.label or None,
    )  # fmt: skip
    for x, y, note in zip(mark.x, mark.y, mark.notes, strict=False):
        axes.annotate(
            note, (x, y), (-8, 0), textcoords="offset points", ha="right", va="center", fontsize=SMALL,
            color=INK, zorder=4, bbox={"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.6},
        )  # fmt: skip


@_draw.register
def _band(mark: Band, axes: Axes, panel: Panel, order: float) -> None:
    style: dict[str, Any] = {"color": mark.colour, "alpha": mark.opacity, "lw": 0, "label": mark.label or None}
    if mark.x is None:
        axes.axhspan(float(mark.low), float(mark.high), zorder=order / 10, **style)
    else:
        axes.fill_between(mark.x, mark.low, mark.high, zorder=order / 10, **style)


@_draw.register
def _span(mark: Span, axes: Axes, panel: Panel, order: float) -> None:
    axes.axvspan(
        mark.start, mark.end, color=mark.colour, alpha=mark.opacity, lw=0, zorder=order / 10, label=mark.label or None
    )


@_draw.register
def _level(mark: Level, axes: Axes, panel: Panel, order: float) -> None:
    axes.axhline(mark.y, color=mark.colour, lw=0.9 if mark.dashed else 0.5, ls=DASHES[mark.dashed], zorder=1)
    if mark.note:
        axes.annotate(
            mark.note, (0.995, mark.y), (0, 2), axes.get_yaxis_transform(), "offset points", ha="right", va="bottom",
            fontsize=SMALL - 0.5, color=MUTED,
        )  # fmt: skip


@_draw.register
def _bars(mark: Bars, axes: Axes, panel: Panel, order: float) -> None:
    count = len(mark.names)
    axes.barh(range(count), mark.sizes, color=list(mark.colours), height=0.66)
    axes.set_yticks(range(count), list(mark.names))
    axes.set_ylim(max(count, 1) - 0.4, -0.6)
    for place, note in enumerate(mark.notes):
        axes.annotate(
            note, (1.0, place), (4, 0), axes.get_yaxis_transform(), "offset points", va="center", fontsize=SMALL,
            color=INK, annotation_clip=False,
        )  # fmt: skip


@_draw.register
def _heat(mark: Heat, axes: Axes, panel: Panel, order: float) -> None:
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


def _write_values(axes: Axes, mark: Heat, scale: Callable[[Any], Any]) -> None:
    """The numbers in their cells, white on dark ones."""
    for (row, column), value in np.ndenumerate(mark.values):
        if np.isfinite(value):
            dark = abs(2 * float(scale(value)) - 1) > 0.6
            text = f"{value:.2f}".replace("-", "−")
            axes.text(column, row, text, ha="center", va="center", fontsize=6, color="white" if dark else INK)
