"""Measured and predicted channel, and residual with noise band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from modeling.number_format import axis_label
from truewrench.plots.charts.chart import Band, Chart, Level, Line, Mark, Panel, Points, Span, value_limits
from truewrench.plots.charts.matplotlib_chart import draw_panel, matplotlib_figure
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.style import HELD_OUT, MEASURED, QUIET_NOISE

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
    return matplotlib_figure(time_series_chart(sides, channel))


def time_series_chart(sides: Sequence[LabelledComparison], channel: int) -> Chart:
    """Measured and predicted above the residual of a channel, a column per model; each residual in its own scale."""
    above = tuple(measured_panel(side, channel, titled=True) for side in sides)
    below = tuple(residual_panel(side, channel, residual_limits([side], channel)) for side in sides)
    return Chart(
        rows=(above, below), heights=(1, 1.25), row_height=HEIGHT, main=(1, len(sides) - 1), shared_x=True,
        between_rows=16,
    )  # fmt: skip


def measured_chart(sides: Sequence[LabelledComparison], channel: int) -> Chart:
    """Measured and predicted of a channel, a column per model, in one scale."""
    panels = tuple(measured_panel(side, channel, titled=True) for side in sides)
    return Chart(rows=(panels,), row_height=2 * HEIGHT, main=(0, len(sides) - 1), shared_y=True)


def measured_panel(side: LabelledComparison, channel: int, *, titled: bool = False) -> Panel:
    """Measured and predicted of a channel over time, of static poses by their number."""
    measured, predicted = side.measured[:, channel], side.predicted[:, channel]
    return Panel(
        marks=(_points if side.recording.at_rest else _lines)(side, measured, predicted),
        title=side.label if titled else "",
        title_colour=side.colour,
        x_label=instants_label(side),
        y_label=axis_label(*channel_labels([side])[channel]),
        x_limits=time_limits(side),
        y_limits=value_limits([measured, predicted]),
    )


def residual_panel(side: LabelledComparison, channel: int, limits: tuple[float, float]) -> Panel:
    """Residual with its noise band over time, samples (pale) and trend; of static poses as points with stems."""
    name, unit = channel_labels([side])[channel]
    return Panel(
        marks=(*noise_marks(side, channel), *_residual_marks(side, side.residual[:, channel])),
        x_label=instants_label(side),
        y_label=axis_label(f"residual of {name}", unit),
        x_limits=time_limits(side),
        y_limits=limits,
    )


def residual_limits(sides: Sequence[LabelledComparison], channel: int) -> tuple[float, float]:
    """Limits that contain the residual of every model, and the noise floor."""
    largest = max(float(np.abs(side.residual[:, channel]).max()) for side in sides)
    limit = 1.12 * max(largest, 1.1 * float(sides[0].floor[channel]))
    return (-limit, limit) if limit > 0 else (-1.0, 1.0)


def noise_marks(side: LabelledComparison, channel: int) -> tuple[Mark, ...]:
    """Bands: ± noise of one sample, and within it ± noise of the mean over the repeats."""
    floor, repeats = float(side.floor[channel]), side.recording.repeats
    sample = Band(low=-floor, high=floor, label=f"± {side.noise_label}")
    if repeats == 1:
        return sample, Level(y=0)
    quiet = floor / np.sqrt(repeats)
    mean = Band(low=-quiet, high=quiet, colour=QUIET_NOISE, label=f"± noise of the mean of {repeats}")
    return sample, mean, Level(y=0)


def draw_residual(axes: Axes, side: LabelledComparison, channel: int) -> None:
    """The residual on axes that are labelled elsewhere."""
    draw_panel(axes, replace(residual_panel(side, channel, residual_limits([side], channel)), x_label="", y_label=""))


def _residual_marks(side: LabelledComparison, residual: Array) -> tuple[Mark, ...]:
    if side.recording.at_rest:
        low, high = np.minimum(residual, 0), np.maximum(residual, 0)
        return (Points(x=side.instants, y=residual, colour=side.colour, size=3.2, low=low, high=high),)
    trend = running_mean(residual, max(1, len(residual) // TREND_PARTS))
    whose = "residual" if side.recording.repeats == 1 else "residual, mean over the repeats"
    samples = Line(x=side.instants, y=residual, colour=side.colour, width=0.5, opacity=0.45, label=whose)
    smooth = Line(x=side.instants, y=trend, colour=side.colour, width=1.3, label="its moving mean")
    return (samples, smooth, *_events(side))


def _events(side: LabelledComparison) -> tuple[Mark, ...]:
    events = side.comparison.noise.events if side.recording.repeats == 1 else ()
    return tuple(Span(start=a, end=b, colour=HELD_OUT, opacity=0.18, label="transient event") for a, b in events)


def time_limits(side: LabelledComparison) -> tuple[float, float]:
    """One repeat with a margin at both ends."""
    first, last = float(side.instants[0]), float(side.instants[-1])
    margin = 0.5 if side.recording.at_rest else 0.012 * (last - first)
    return first - margin, last + margin


def _lines(side: LabelledComparison, measured: Array, predicted: Array) -> tuple[Mark, ...]:
    at = side.instants
    return (
        Line(x=at, y=measured, colour=MEASURED, width=4.5, opacity=0.45, label="measured"),
        Line(x=at, y=predicted, colour=side.colour, width=1.2, label="predicted"),
    )


def _points(side: LabelledComparison, measured: Array, predicted: Array) -> tuple[Mark, ...]:
    at = side.instants
    return (
        Points(x=at, y=measured, colour=MEASURED, size=5.5, label="measured"),
        Points(x=at, y=predicted, colour=side.colour, size=9, symbol="_", label="predicted"),
    )


def instants_label(side: LabelledComparison) -> str:
    """What is across: time in a repeat or run, or the number of a pose."""
    if side.recording.at_rest:
        return "pose, in the order of recording"
    return "time in one repeat (s)" if side.recording.repeats > 1 else "time (s)"
