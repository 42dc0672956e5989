"""Series plot: one channel measured and predicted, and below it what is left, with the noise as a band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from truewrench.plots.envelope import envelope, running_mean
from truewrench.plots.number import labelled
from truewrench.plots.side import Side, channel_labels
from truewrench.plots.style import HELD_OUT, LEGEND, MEASURED, MUTED, NOISE, QUIET_NOISE, WIDTH, Sheet, heading, name_y

Array = NDArray[np.float64]

HEIGHT = 100
"""Mean height of the two panels."""
TREND_PARTS = 80
"""Parts of a repeat over which the samples are averaged to show their trend."""


def series_figure(sides: Sequence[Side], channel: int) -> Figure:
    """One channel, a column for each side: the series, and their difference with ± noise of the mean and ± floor."""
    width = WIDTH if len(sides) > 1 else WIDTH / 2 - 10
    sheet = Sheet(rows=2, columns=len(sides), panel_height=HEIGHT, width=width, between_rows=24)
    figure, panels = sheet.panels(sharex=True, sharey="row", heights=(1, 1.25))
    name, unit = channel_labels(sides)[channel]
    for column, side in enumerate(sides):
        top, bottom = panels[:, column]
        heading(top, side.label, side.colour)
        (_points if side.recording.at_rest else _lines)(top, side, channel)
        _residual(bottom, side, channel)
        bottom.set_xlabel("pose, in the order taken" if side.recording.at_rest else _time_label(side))
    panels[1, 0].set_ylim(*residual_limits(sides, channel))
    name_y(panels[0, 0], labelled(name, unit))
    name_y(panels[1, 0], labelled(f"{name} left", unit))
    panels[0, 0].legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))
    panels[1, -1].legend(**LEGEND, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 1.24))
    return figure


def residual_limits(sides: Sequence[Side], channel: int) -> tuple[float, float]:
    """Limits that hold what is left on every side, and the noise floor."""
    largest = max(float(np.abs(side.residual[:, channel]).max()) for side in sides)
    reach = 1.12 * max(largest, 1.1 * float(sides[0].floor[channel]))
    return (-reach, reach) if reach > 0 else (-1.0, 1.0)


def noise_band(axes: Axes, side: Side, channel: int) -> None:
    """± the noise of one sample, and within it ± the noise of the mean over the repeats."""
    floor, repeats = float(side.floor[channel]), side.recording.repeats
    axes.axhspan(-floor, floor, color=NOISE, lw=0, zorder=0, label=f"± {side.noise_words}")
    if repeats > 1:
        quiet = floor / np.sqrt(repeats)
        axes.axhspan(-quiet, quiet, color=QUIET_NOISE, lw=0, zorder=0.1, label=f"± noise of the mean of {repeats}")
    axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)


def draw_residual(axes: Axes, side: Side, channel: int) -> None:
    """What is left, over time: its samples, pale, and their trend."""
    left = side.residual[:, channel]
    trend = running_mean(left, max(1, len(left) // TREND_PARTS))
    axes.plot(*envelope(side.instants, left), color=side.colour, lw=0.5, alpha=0.45)
    axes.plot(*envelope(side.instants, trend), color=side.colour, lw=1.3, solid_joinstyle="round")
    if side.recording.repeats == 1:
        for number, (start, end) in enumerate(side.comparison.noise.events):
            label = None if number else "an event"
            axes.axvspan(start, end, color=HELD_OUT, alpha=0.18, lw=0, zorder=0.15, label=label)
    axes.set_xlim(*time_limits(side))


def time_limits(side: Side) -> tuple[float, float]:
    """The whole repeat and a little room at both ends."""
    first, last = float(side.instants[0]), float(side.instants[-1])
    room = 0.012 * (last - first)
    return first - room, last + room


def draw_stems(axes: Axes, side: Side, channel: int) -> None:
    """What is left in each pose, as a point on a stem."""
    left = side.residual[:, channel]
    axes.vlines(side.instants, 0, left, color=side.colour, lw=1.0)
    axes.plot(side.instants, left, "o", color=side.colour, ms=3.2)


def _residual(axes: Axes, side: Side, channel: int) -> None:
    noise_band(axes, side, channel)
    (draw_stems if side.recording.at_rest else draw_residual)(axes, side, channel)


def _lines(axes: Axes, side: Side, channel: int) -> None:
    axes.plot(*envelope(side.instants, side.measured[:, channel]), color=MEASURED, lw=2.4, alpha=0.75, label="measured")
    axes.plot(*envelope(side.instants, side.predicted[:, channel]), color=side.colour, lw=1.0, label="predicted")


def _points(axes: Axes, side: Side, channel: int) -> None:
    axes.plot(side.instants, side.measured[:, channel], "o", color=MEASURED, ms=5.5, alpha=0.75, label="measured")
    axes.plot(side.instants, side.predicted[:, channel], "_", color=side.colour, ms=9, mew=1.6, label="predicted")
    axes.margins(x=0.02)


def _time_label(side: Side) -> str:
    return "time in one repeat (s)" if side.recording.repeats > 1 else "time (s)"
