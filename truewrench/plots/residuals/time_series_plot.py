"""Measured and predicted channel, and residual with noise band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.recordings.reports.decimation import min_max_decimated
from modeling.number_format import axis_label
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.style import (
    HELD_OUT,
    LEGEND,
    MEASURED,
    MUTED,
    NOISE,
    QUIET_NOISE,
    WIDTH,
    PanelGrid,
    label_y_axis,
    panel_title,
)

Array = NDArray[np.float64]


def running_mean(y: Array, length: int) -> Array:
    """The mean over `length` samples about each sample, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(y)])
    index = np.arange(len(y))
    low, high = np.maximum(index - length // 2, 0), np.minimum(index + (length + 1) // 2, len(y))
    return np.asarray((total[high] - total[low]) / (high - low))


HEIGHT = 100
"""Mean height of the two panels."""
TREND_PARTS = 80
"""Intervals of a repeat over which the trend is averaged."""


def time_series_figure(sides: Sequence[LabelledComparison], channel: int) -> Figure:
    """One channel, a column per model: measured and predicted, and the residual with ± noise bands."""
    width = WIDTH if len(sides) > 1 else WIDTH / 2 - 10
    sheet = PanelGrid(rows=2, columns=len(sides), panel_height=HEIGHT, width=width, between_rows=24)
    figure, panels = sheet.panels(sharex=True, sharey="row", heights=(1, 1.25))
    name, unit = channel_labels(sides)[channel]
    for column, side in enumerate(sides):
        top, bottom = panels[:, column]
        panel_title(top, side.label, side.colour)
        (_points if side.recording.at_rest else _lines)(top, side, channel)
        draw_residual(bottom, side, channel)
        bottom.set_xlabel("pose, in the order of recording" if side.recording.at_rest else _time_label(side))
    panels[1, 0].set_ylim(*residual_limits(sides, channel))
    label_y_axis(panels[0, 0], axis_label(name, unit))
    label_y_axis(panels[1, 0], axis_label(f"residual of {name}", unit))
    panels[0, 0].legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))
    panels[1, -1].legend(**LEGEND, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 1.24))
    return figure


def residual_limits(sides: Sequence[LabelledComparison], channel: int) -> tuple[float, float]:
    """Limits that contain the residual of every model, and the noise floor."""
    largest = max(float(np.abs(side.residual[:, channel]).max()) for side in sides)
    limit = 1.12 * max(largest, 1.1 * float(sides[0].floor[channel]))
    return (-limit, limit) if limit > 0 else (-1.0, 1.0)


def noise_band(axes: Axes, side: LabelledComparison, channel: int) -> None:
    """Bands: ± noise of one sample, and within it ± noise of the mean over the repeats."""
    floor, repeats = float(side.floor[channel]), side.recording.repeats
    axes.axhspan(-floor, floor, color=NOISE, lw=0, zorder=0, label=f"± {side.noise_label}")
    if repeats > 1:
        quiet = floor / np.sqrt(repeats)
        axes.axhspan(-quiet, quiet, color=QUIET_NOISE, lw=0, zorder=0.1, label=f"± noise of the mean of {repeats}")
    axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)


def draw_residual(axes: Axes, side: LabelledComparison, channel: int) -> None:
    """Residual with its noise band over time, samples (pale) and trend; of static poses as a stem plot."""
    noise_band(axes, side, channel)
    residual = side.residual[:, channel]
    if side.recording.at_rest:
        axes.vlines(side.instants, 0, residual, color=side.colour, lw=1.0)
        axes.plot(side.instants, residual, "o", color=side.colour, ms=3.2)
        return
    trend = running_mean(residual, max(1, len(residual) // TREND_PARTS))
    axes.plot(*min_max_decimated(side.instants, residual), color=side.colour, lw=0.5, alpha=0.45)
    axes.plot(*min_max_decimated(side.instants, trend), color=side.colour, lw=1.3, solid_joinstyle="round")
    if side.recording.repeats == 1:
        for number, (start, end) in enumerate(side.comparison.noise.events):
            label = None if number else "transient event"
            axes.axvspan(start, end, color=HELD_OUT, alpha=0.18, lw=0, zorder=0.15, label=label)
    axes.set_xlim(*time_limits(side))


def time_limits(side: LabelledComparison) -> tuple[float, float]:
    """One repeat with a margin at both ends."""
    first, last = float(side.instants[0]), float(side.instants[-1])
    margin = 0.012 * (last - first)
    return first - margin, last + margin


def _lines(axes: Axes, side: LabelledComparison, channel: int) -> None:
    axes.plot(
        *min_max_decimated(side.instants, side.measured[:, channel]),
        color=MEASURED,
        lw=2.4,
        alpha=0.75,
        label="measured",
    )
    axes.plot(
        *min_max_decimated(side.instants, side.predicted[:, channel]), color=side.colour, lw=1.0, label="predicted"
    )


def _points(axes: Axes, side: LabelledComparison, channel: int) -> None:
    axes.plot(side.instants, side.measured[:, channel], "o", color=MEASURED, ms=5.5, alpha=0.75, label="measured")
    axes.plot(side.instants, side.predicted[:, channel], "_", color=side.colour, ms=9, mew=1.6, label="predicted")
    axes.margins(x=0.02)


def _time_label(side: LabelledComparison) -> str:
    return "time in one repeat (s)" if side.recording.repeats > 1 else "time (s)"
