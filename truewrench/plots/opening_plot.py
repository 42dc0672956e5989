"""Opening plot: the one channel that fails most, before and after, for the top of a report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from diagnosis.maps import residual_maps
from estimation.noise import NoiseSource
from truewrench.plots.number import labelled
from truewrench.plots.passing_plot import passing, spread_of_means
from truewrench.plots.series_plot import draw_residual, draw_stems, noise_band, residual_limits
from truewrench.plots.side import Side, channel_labels
from truewrench.plots.style import MUTED, NOISE, Sheet, heading, name_y

HEIGHT = 135
STANDS_OUT = 2.0
"""Times its noise that something must reach to be shown for its size."""


def opening_figure(sides: Sequence[Side]) -> Figure:
    """What is left in the loudest channel, a column for each side, in one scale."""
    figure, panels = Sheet(rows=1, columns=len(sides), panel_height=HEIGHT).panels(sharex=True, sharey=True)
    passes, channel = loudest(sides[0])
    for axes, side in zip(panels[0], sides, strict=True):
        heading(axes, side.label, side.colour)
        if passes:
            time, left = passing(side)
            spread = float(spread_of_means(side)[channel])
            axes.axhspan(-2 * spread, 2 * spread, color=NOISE, lw=0, zorder=0)
            axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)
            axes.plot(time, left[:, channel], color=side.colour, lw=1.3, drawstyle="steps-mid")
            axes.margins(x=0.012)
        else:
            noise_band(axes, side, channel)
            (draw_stems if side.recording.at_rest else draw_residual)(axes, side, channel)
            axes.set_ylim(*residual_limits(sides, channel))
        axes.set_xlabel("pose" if side.recording.at_rest else "time (s)")
    name, unit = channel_labels(sides)[channel]
    name_y(panels[0, 0], labelled(f"{name} left", unit))
    return figure


def loudest(side: Side) -> tuple[bool, int]:
    """Whether what does not repeat stands out more than what does, and the channel in which it stands out most."""
    repeats = side.recording.repeats
    floor = np.maximum(side.floor, 1e-300)
    steady = np.sqrt((side.residual**2).mean(axis=0)) / floor * np.sqrt(repeats)
    if repeats == 1 or side.recording.at_rest or not side.recording.continuous:
        own_judge = side.comparison.noise.source is NoiseSource.RESIDUAL and steady.max() < STANDS_OUT
        return False, _most_explained(side) if own_judge else int(steady.argmax())
    _, left = passing(side)
    moving = np.sqrt((left**2).mean(axis=0)) / np.maximum(spread_of_means(side), 1e-300)
    passes = bool(moving.max() > max(steady.max(), STANDS_OUT))
    return passes, int((moving if passes else steady).argmax())


def _most_explained(side: Side) -> int:
    """The channel of the map that explains most: where the residual is its own noise, no size tells."""
    channels = side.recording.channels
    best = residual_maps(side.comparison, dict.fromkeys(channels, 0.0))[0]
    return channels.index(best.channel)
