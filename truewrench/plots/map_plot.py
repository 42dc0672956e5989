"""Map plot: small multiples of one channel's residual against what might cause it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnosis.maps import ResidualMap
from truewrench.plots.number import labelled
from truewrench.plots.style import FAILING, MEASURED, MUTED, NOISE, SMALL, Sheet, name_y

ROW = 92


def map_figure(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Figure:
    """A row for each model (label, maps of one channel), a column for each variable, all in one scale.

    Cells that are significant and above tolerance are full and coloured, the others hollow and grey; bars are 95 %
    intervals; the band is the tolerance.
    """
    columns = len(rows[0][1])
    sheet = Sheet(rows=len(rows), columns=columns, panel_height=ROW, top=8, left=84, between_columns=16)
    figure, panels = sheet.panels(sharex="col", sharey=True)
    for row, (label, maps) in enumerate(rows):
        for column, shown in enumerate(maps):
            axes = panels[row, column]
            _cells(axes, shown)
            if row == len(rows) - 1:
                axes.set_xlabel(labelled(shown.variable, shown.variable_unit), fontsize=SMALL + 0.5)
        name_y(panels[row, 0], f"{label}\n{labelled(maps[0].channel, maps[0].channel_unit)}", SMALL + 0.5)
    panels[0, 0].set_ylim(*_limits([m for _, maps in rows for m in maps]))
    for axes in panels[-1]:
        axes.locator_params(axis="x", nbins=4)
    return figure


def _cells(axes: Axes, shown: ResidualMap) -> None:
    axes.axhspan(-shown.tolerance, shown.tolerance, color=NOISE, lw=0, zorder=0)
    axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)
    axes.plot(shown.centre, shown.mean, color=MEASURED, lw=0.6, alpha=0.6, zorder=1)
    for kept, face, edge, size in ((~shown.striking, "white", MEASURED, 3.0), (shown.striking, FAILING, FAILING, 3.8)):
        if kept.any():
            axes.vlines(shown.centre[kept], shown.low[kept], shown.high[kept], color=edge, lw=1.1, zorder=2)
            axes.plot(shown.centre[kept], shown.mean[kept], "o", ms=size, mfc=face, mec=edge, mew=0.9, zorder=3)


def _limits(maps: Sequence[ResidualMap]) -> tuple[float, float]:
    """Limits that hold every mean, and the intervals as far as they are not absurdly wide."""
    mean = max(float(np.abs(m.mean).max()) for m in maps)
    bars = np.concatenate([np.maximum(np.abs(m.low), np.abs(m.high)) for m in maps])
    reach = 1.1 * max(mean, min(float(np.quantile(bars, 0.95)), 2 * mean), 1.3 * maps[0].tolerance)
    return -reach, reach
