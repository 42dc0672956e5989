"""Residual maps of one channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from diagnosis.comparison.residual_map import ResidualMap
from modeling.number_format import axis_label, format_number, format_unit
from truewrench.plots.charts.chart import Band, Chart, Level, Line, Mark, Panel, Points
from truewrench.plots.charts.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import MEASURED, MISFIT_COLOUR

ROW_HEIGHT = 112


def residual_map_figure(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Figure:
    """Residual maps of one channel: a row per model (label, maps), a column per variable."""
    return matplotlib_figure(residual_map_chart(rows))


def residual_map_chart(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Chart:
    """Residual maps of one channel: a row per model (label, maps), a column per variable, each row in its own scale.

    Cells that are significant and above tolerance are full and coloured, the others hollow and grey; bars are 95 %
    intervals; the band is the tolerance.
    """
    panels = [tuple(_panel("" if n else label, m, _limits(maps)) for n, m in enumerate(maps)) for label, maps in rows]
    return Chart(
        rows=tuple(panels), row_height=ROW_HEIGHT, main=(len(rows) - 1, 0), shared_x=True, shared_y=True,
        left=76, between_rows=30,
    )  # fmt: skip


def _panel(label: str, shown: ResidualMap, limits: tuple[float, float]) -> Panel:
    return Panel(
        marks=(_tolerance(shown), Level(y=0), *_cells(shown)),
        title=label,
        x_label=axis_label(shown.variable, shown.variable_unit),
        y_label=axis_label(f"residual of {shown.channel}", shown.channel_unit),
        y_limits=limits,
    )


def _tolerance(shown: ResidualMap) -> Band:
    """Its size is in the legend: beside a large residual the band is as thin as a line."""
    size = f"tolerance ± {format_number(shown.tolerance, 2)} {format_unit(shown.channel_unit)}"
    return Band(low=-shown.tolerance, high=shown.tolerance, label=size)


def _cells(shown: ResidualMap) -> tuple[Mark, ...]:
    full = shown.practically_significant
    kinds = (
        (~full, MEASURED, "mean residual with 95 % interval, negligible or within noise"),
        (full, MISFIT_COLOUR, "significant and above tolerance"),
    )
    cells = tuple(
        Points(
            x=shown.centre[inside], y=shown.mean[inside], low=shown.low[inside], high=shown.high[inside], colour=colour,
            size=3.0 if colour == MEASURED else 3.8, hollow=colour == MEASURED, label=label,
        )
        for inside, colour, label in kinds
    )  # fmt: skip
    return (Line(x=shown.centre, y=shown.mean, colour=MEASURED, width=0.6, opacity=0.6), *cells)


def _limits(maps: Sequence[ResidualMap]) -> tuple[float, float]:
    """Limits that contain every mean, and every interval up to thrice what most of them need.

    Most: the 95 % quantile of the intervals, at most twice the largest mean.
    """
    mean = max(float(np.abs(m.mean).max()) for m in maps)
    bars = np.concatenate([np.maximum(np.abs(m.low), np.abs(m.high)) for m in maps])
    most = max(mean, min(float(np.quantile(bars, 0.95)), 2 * mean), 1.3 * maps[0].tolerance)
    limit = 1.1 * max(most, min(float(bars.max()), 3 * most))
    return -limit, limit
