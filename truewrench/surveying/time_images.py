"""Verdicts, errors and effect parameters of many recordings over time, one panel below the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import datetime, timedelta

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from modeling.number_format import axis_label
from truewrench.plots.style import ADEQUATE_COLOUR, FAINT, INK, LEGEND, MISFIT_COLOUR, PanelGrid, panel_title
from truewrench.plots.svg_image import SvgImage
from truewrench.surveying.change_detection import ChangeKind, QuantityChange
from truewrench.surveying.quantity_series import QuantitySeries, quantity_series, rows_in_time_order
from truewrench.surveying.survey_row import SurveyRow

COLOURS = {
    "nothing_missing": "#00619a",
    "explained": "#00724f",
    "partly_explained": "#9a6200",
    "unexplained": "#b03a00",
    "error": "#646c76",
}
"""Colour of each verdict, as in the report."""
MAX_PANELS = 8
"""Quantities plotted; those that change first."""
ALWAYS = ("m",)
"""Tool parameters plotted even without a change: the mass."""
PANEL = 92
"""Height of a panel in CSS pixels."""
MARGIN = 0.02
"""Share of the time span kept free at both ends."""
FORMATS = ["%Y", "%b %Y", "%d %b", "%H:%M", "%H:%M", "%H:%M:%S"]
ZERO_FORMATS = ["%Y", "%b %Y", "%d %b", "%d %b", "%H:%M", "%H:%M:%S"]
"""Of ticks at years, months, days, hours, minutes, seconds; and of those that begin the next larger unit."""


def survey_image(
    rows: Sequence[SurveyRow], changes: Sequence[QuantityChange], labels: Mapping[str, str]
) -> SvgImage | None:
    """Verdicts, errors and quantities over time; None for fewer than two recordings with a time."""
    shown = rows_in_time_order(rows)
    if len(shown) < 2:
        return None
    by_name = {change.series.name: change for change in changes}
    chosen = series_to_draw(quantity_series(rows), by_name)
    omitted = max(0, len(chosen) - MAX_PANELS)
    caption = "Bars: ± one standard deviation. Hollow: the model is not adequate, so that the bar is too short."
    caption += f" {omitted} more quantities without a change are in the table only." if omitted else ""
    quantities = [(s, by_name.get(s.name)) for s in chosen[:MAX_PANELS]]
    alt = "Verdicts, errors and quantities over the times of the recordings."
    return SvgImage(lambda: _survey_figure(shown, quantities, labels), alt, caption)


def series_to_draw(candidates: Sequence[QuantitySeries], changed: Collection[str]) -> list[QuantitySeries]:
    """Series with a change, then the mass, then each effect's first parameter (its amplitude), then the others."""
    first = {series.effect: series.name for series in reversed(candidates)}
    ranks = [
        [s for s in candidates if s.name in changed],
        [s for s in candidates if s.name in ALWAYS],
        [s for s in candidates if s.effect and s.name == first[s.effect]],
        [s for s in candidates if s.effect],
    ]
    return list(dict.fromkeys(series for rank in ranks for series in rank))


def _survey_figure(
    rows: Sequence[SurveyRow],
    quantities: Sequence[tuple[QuantitySeries, QuantityChange | None]],
    labels: Mapping[str, str],
) -> Figure:
    """The panels, on one axis of time."""
    verdicts = [v for v in labels if any(_verdict(row) == v for row in rows)]
    panels: list[Callable[[Axes], None]] = [lambda axes: _draw_verdicts(axes, rows, {v: labels[v] for v in verdicts})]
    worst = Counter(row.outcome.loudest.channel for row in rows if row.outcome.loudest is not None)
    panels += [lambda axes: _draw_errors(axes, rows, worst.most_common(1)[0][0])] if worst else []
    panels += [lambda axes, pair=pair: _draw_quantity(axes, *pair) for pair in quantities]  # type: ignore[misc]
    heights = [max(0.35, 0.22 * len(verdicts)), *[1.0] * (len(panels) - 1)]
    sheet = PanelGrid(rows=len(panels), columns=1, panel_height=PANEL, left=128, between_rows=34)
    figure, grid = sheet.panels(heights=heights, sharex=True)
    for draw, axes in zip(panels, grid[:, 0], strict=True):
        draw(axes)
    _date_axis(grid[-1, 0], [row.moment for row in rows])
    return figure


def _verdict(row: SurveyRow) -> str:
    return row.outcome.verdict or "error"


def _draw_verdicts(axes: Axes, rows: Sequence[SurveyRow], labels: Mapping[str, str]) -> None:
    panel_title(axes, "verdict")
    moments = {v: [row.moment for row in rows if _verdict(row) == v] for v in labels}
    for line, (verdict, times) in enumerate(moments.items()):
        axes.plot(date2num(times), [line] * len(times), "|", color=COLOURS[verdict], ms=9, mew=2.0)
    axes.set_yticks(range(len(labels)), [f"{labels[v]} ({len(times)})" for v, times in moments.items()])
    for label, verdict in zip(axes.get_yticklabels(), labels, strict=True):
        label.set_color(COLOURS[verdict])
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _draw_errors(axes: Axes, rows: Sequence[SurveyRow], channel: str) -> None:
    """Error with the rigid tool and with the effects added, of the channel that is the worst in most recordings."""
    pairs = [(row.moment, c) for row in rows for c in row.outcome.channels if c.channel == channel]
    known = [(m, c.before, c.after) for m, c in pairs if c.before is not None and c.after is not None]
    kind = "systematic error" if all(c.systematic_after is not None for _, c in pairs) else "error"
    panel_title(axes, axis_label(f"{kind} in {channel}", pairs[0][1].unit))
    time = date2num([moment for moment, _, _ in known])
    axes.plot(time, [before for _, before, _ in known], "o", color=MISFIT_COLOUR, ms=3.6, label="rigid tool")
    added = [after for _, _, after in known]
    axes.plot(time, added, "o", color=ADEQUATE_COLOUR, ms=3.6, label="with the effects added")
    axes.set_ylim(bottom=0)
    axes.legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))


def _draw_quantity(axes: Axes, series: QuantitySeries, change: QuantityChange | None) -> None:
    """A quantity with its std, hollow where the model is not adequate, and the line of its change."""
    panel_title(axes, axis_label("m, the tool's mass" if series.name == "m" else series.name, series.unit))
    time, known = date2num(series.moments), np.isfinite(series.std)
    for adequate, face in ((True, INK), (False, "white")):
        part = series.trusted == adequate
        shown = part & known
        axes.errorbar(time[shown], series.value[shown], series.std[shown], fmt="none", ecolor=FAINT, elinewidth=1.6)
        axes.plot(time[part], series.value[part], "o", color=INK, mfc=face, ms=3.6, mew=0.8)
    if change is not None:
        moments, levels = zip(*_levels(change), strict=True)
        axes.plot(date2num(moments), levels, color=MISFIT_COLOUR, lw=1.4, zorder=3)
    axes.set_ylim(*_limits(series))


def _levels(change: QuantityChange) -> list[tuple[datetime, float]]:
    """Vertices of the line of a change."""
    if change.kind is ChangeKind.TREND:
        return [(change.start, change.before), (change.end, change.after)]
    middle, moments = change.start + (change.end - change.start) / 2, change.series.moments
    return [(moments[0], change.before), (middle, change.before), (middle, change.after), (moments[-1], change.after)]


def _limits(series: QuantitySeries) -> tuple[float, float]:
    """Limits that contain the values, and their bars up to the span of the values."""
    low, high = float(series.value.min()), float(series.value.max())
    span = high - low or 0.1 * abs(high) or 1.0
    bar = np.minimum(np.where(np.isfinite(series.std), series.std, 0.0), span)
    low, high = float((series.value - bar).min()), float((series.value + bar).max())
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
