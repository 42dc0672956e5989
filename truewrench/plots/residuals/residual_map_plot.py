"""Residual maps of one channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnosis.comparison.residual_map import ResidualMap
from modeling.number_format import axis_label
from truewrench.plots.style import MEASURED, MISFIT_COLOUR, MUTED, NOISE, SMALL, PanelGrid, label_y_axis

ROW_HEIGHT = 92


def residual_map_figure(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Figure:
    """Residual maps of one channel: a row per model (label, maps), a column per variable, common scale.

    Cells that are significant and above tolerance are full and coloured, the others hollow and grey; bars are 95 %
    intervals; the band is the tolerance.
    """
    columns = len(rows[0][1])
    sheet = PanelGrid(rows=len(rows), columns=columns, panel_height=ROW_HEIGHT, top=8, left=84, between_columns=16)
    figure, panels = sheet.panels(sharex="col", sharey=True)
    for row, (label, maps) in enumerate(rows):
        for column, shown in enumerate(maps):
            axes = panels[row, column]
            _cells(axes, shown)
            if row == len(rows) - 1:
                axes.set_xlabel(axis_label(shown.variable, shown.variable_unit), fontsize=SMALL + 0.5)
        label_y_axis(panels[row, 0], f"{label}\n{axis_label(maps[0].channel, maps[0].channel_unit)}", SMALL + 0.5)
    panels[0, 0].set_ylim(*_limits([m for _, maps in rows for m in maps]))
    for axes in panels[-1]:
        axes.locator_params(axis="x", nbins=4)
    return figure


def _cells(axes: Axes, shown: ResidualMap) -> None:
    axes.axhspan(-shown.tolerance, shown.tolerance, color=NOISE, lw=0, zorder=0)
    axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)
    axes.plot(shown.centre, shown.mean, color=MEASURED, lw=0.6, alpha=0.6, zorder=1)
    for cells, face, edge, size in (
        (~shown.practically_significant, "white", MEASURED, 3.0),
        (shown.practically_significant, MISFIT_COLOUR, MISFIT_COLOUR, 3.8),
    ):
        if cells.any():
            axes.vlines(shown.centre[cells], shown.low[cells], shown.high[cells], color=edge, lw=1.1, zorder=2)
            axes.plot(shown.centre[cells], shown.mean[cells], "o", ms=size, mfc=face, mec=edge, mew=0.9, zorder=3)


def _limits(maps: Sequence[ResidualMap]) -> tuple[float, float]:
    """Limits that contain every mean, and the intervals up to their 95 % quantile or twice the largest mean."""
    mean = max(float(np.abs(m.mean).max()) for m in maps)
    bars = np.concatenate([np.maximum(np.abs(m.low), np.abs(m.high)) for m in maps])
    limit = 1.1 * max(mean, min(float(np.quantile(bars, 0.95)), 2 * mean), 1.3 * maps[0].tolerance)
    return -limit, limit
