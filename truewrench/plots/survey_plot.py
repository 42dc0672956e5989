"""Verdicts, errors and effect parameters of many recordings over time, one panel below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure
from numpy.typing import NDArray

from truewrench.plots.style import ADEQUATE_COLOUR, FAINT, INK, LEGEND, MISFIT_COLOUR, PanelGrid, panel_title
from truewrench.text.number_format import axis_label

Array = NDArray[np.float64]

PANEL = 92
"""Height of a panel in CSS pixels."""
MARGIN = 0.02
"""Share of the time span kept free at both ends."""
FORMATS = ["%Y", "%b %Y", "%d %b", "%H:%M", "%H:%M", "%H:%M:%S"]
ZERO_FORMATS = ["%Y", "%b %Y", "%d %b", "%d %b", "%H:%M", "%H:%M:%S"]
"""Of ticks at years, months, days, hours, minutes, seconds; and of those that begin the next larger unit."""


@dataclass(frozen=True, kw_only=True)
class VerdictTimes:
    """Times of the recordings with one verdict, with label and colour."""

    label: str
    colour: str
    moments: Sequence[datetime]


@dataclass(frozen=True, kw_only=True)
class QuantityOverTime:
    """A quantity over time with its std; hollow where `adequate` is false; `levels` is the line of a change."""

    title: str
    unit: str
    moments: Sequence[datetime]
    value: Array
    std: Array
    adequate: NDArray[np.bool_]
    levels: Sequence[tuple[datetime, float]] = ()


@dataclass(frozen=True, kw_only=True)
class ErrorReduction:
    """Error over time with the rigid tool (before) and with the effects added (after)."""

    title: str
    unit: str
    moments: Sequence[datetime]
    before: Array
    after: Array


def survey_figure(
    verdicts: Sequence[VerdictTimes], errors: ErrorReduction | None, quantities: Sequence[QuantityOverTime]
) -> Figure:
    """The panels, on one axis of time."""
    panels: list[Callable[[Axes], None]] = [lambda axes: _draw_verdicts(axes, verdicts)]
    if errors is not None:
        panels.append(lambda axes: _draw_error_reduction(axes, errors))
    panels += [lambda axes, quantity=quantity: _draw_quantity(axes, quantity) for quantity in quantities]  # type: ignore[misc]
    heights = [max(0.35, 0.22 * len(verdicts)), *[1.0] * (len(panels) - 1)]
    sheet = PanelGrid(rows=len(panels), columns=1, panel_height=PANEL, left=128, between_rows=34)
    figure, grid = sheet.panels(heights=heights, sharex=True)
    for draw, axes in zip(panels, grid[:, 0], strict=True):
        draw(axes)
    _date_axis(grid[-1, 0], [m for verdict in verdicts for m in verdict.moments])
    return figure


def _draw_verdicts(axes: Axes, verdicts: Sequence[VerdictTimes]) -> None:
    panel_title(axes, "verdict")
    for line, verdict in enumerate(verdicts):
        axes.plot(date2num(verdict.moments), [line] * len(verdict.moments), "|", color=verdict.colour, ms=9, mew=2.0)
    axes.set_yticks(range(len(verdicts)), [f"{m.label} ({len(m.moments)})" for m in verdicts])
    for label, verdict in zip(axes.get_yticklabels(), verdicts, strict=True):
        label.set_color(verdict.colour)
    axes.set_ylim(len(verdicts) - 0.4, -0.6)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _draw_error_reduction(axes: Axes, errors: ErrorReduction) -> None:
    panel_title(axes, axis_label(errors.title, errors.unit))
    time = date2num(errors.moments)
    axes.plot(time, errors.before, "o", color=MISFIT_COLOUR, ms=3.6, label="rigid tool")
    axes.plot(time, errors.after, "o", color=ADEQUATE_COLOUR, ms=3.6, label="with the effects added")
    axes.set_ylim(bottom=0)
    axes.legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))


def _draw_quantity(axes: Axes, quantity: QuantityOverTime) -> None:
    panel_title(axes, axis_label(quantity.title, quantity.unit))
    time, known = date2num(quantity.moments), np.isfinite(quantity.std)
    for adequate, face in ((True, INK), (False, "white")):
        part = quantity.adequate == adequate
        shown = part & known
        axes.errorbar(time[shown], quantity.value[shown], quantity.std[shown], fmt="none", ecolor=FAINT, elinewidth=1.6)
        axes.plot(time[part], quantity.value[part], "o", color=INK, mfc=face, ms=3.6, mew=0.8)
    if quantity.levels:
        moments, levels = zip(*quantity.levels, strict=True)
        axes.plot(date2num(moments), levels, color=MISFIT_COLOUR, lw=1.4, zorder=3)
    axes.set_ylim(*_limits(quantity))


def _limits(quantity: QuantityOverTime) -> tuple[float, float]:
    """Limits that contain the values, and their bars up to the span of the values."""
    low, high = float(quantity.value.min()), float(quantity.value.max())
    span = high - low or 0.1 * abs(high) or 1.0
    bar = np.minimum(np.where(np.isfinite(quantity.std), quantity.std, 0.0), span)
    low, high = float((quantity.value - bar).min()), float((quantity.value + bar).max())
    return low - 0.08 * span, high + 0.08 * span


def _date_axis(axes: Axes, moments: Sequence[datetime]) -> None:
    first, last = min(moments), max(moments)
    margin = MARGIN * (last - first) or timedelta(hours=1)
    axes.set_xlim(*date2num([first - margin, last + margin]))
    locator = AutoDateLocator(minticks=3, maxticks=9)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(
        ConciseDateFormatter(locator, formats=FORMATS, zero_formats=ZERO_FORMATS, show_offset=False)
    )
    axes.set_xlabel(f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}")
