"""Residual of the channel with the largest error-to-noise ratio, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from diagnosis.comparison.residual_map import residual_maps
from estimation.noise.recording_noise import NoiseSource
from modeling.number_format import axis_label
from truewrench.plots.fitted_grid import fit_grid
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.residuals.nonperiodic_residual_plot import (
    draw_nonperiodic_residual,
    nonperiodic_residual,
    std_of_interval_means,
)
from truewrench.plots.residuals.time_series_plot import draw_residual, residual_limits
from truewrench.plots.style import PanelGrid, panel_title

HEIGHT = 135
MIN_SIGNAL_TO_NOISE = 2.0
"""Error-to-noise ratio above which a channel is chosen by it."""


def worst_channel_figure(sides: Sequence[LabelledComparison]) -> Figure:
    """Residual of the worst channel, a column per model, in one scale."""
    grid = PanelGrid(rows=1, columns=len(sides), panel_height=HEIGHT)
    figure, panels = grid.panels(sharex=True, sharey=True)
    nonperiodic, channel = worst_channel(sides[0])
    for axes, side in zip(panels[0], sides, strict=True):
        panel_title(axes, side.label, side.colour)
        if nonperiodic:
            time, means = nonperiodic_residual(side)
            draw_nonperiodic_residual(
                axes, time, means[:, channel], float(std_of_interval_means(side)[channel]), side.colour
            )
        else:
            draw_residual(axes, side, channel)
            axes.set_ylim(*residual_limits(sides, channel))
        axes.set_xlabel("pose" if side.recording.at_rest else "time (s)")
    name, unit = channel_labels(sides)[channel]
    panels[0, 0].set_ylabel(axis_label(f"residual of {name}", unit))
    fit_grid(figure, panels, grid)
    return figure


def worst_channel(side: LabelledComparison) -> tuple[bool, int]:
    """Whether the non-periodic residual / noise exceeds the periodic one, and the channel where the larger peaks."""
    repeats = side.recording.repeats
    floor = np.maximum(side.floor, 1e-300)
    periodic_ratio = np.sqrt((side.residual**2).mean(axis=0)) / floor * np.sqrt(repeats)
    if repeats == 1 or side.recording.at_rest or not side.recording.continuous:
        from_residual = (
            side.comparison.noise.source is NoiseSource.RESIDUAL and periodic_ratio.max() < MIN_SIGNAL_TO_NOISE
        )
        return False, _most_explained(side) if from_residual else int(periodic_ratio.argmax())
    _, means = nonperiodic_residual(side)
    nonperiodic_ratio = np.sqrt((means**2).mean(axis=0)) / np.maximum(std_of_interval_means(side), 1e-300)
    nonperiodic = bool(nonperiodic_ratio.max() > max(periodic_ratio.max(), MIN_SIGNAL_TO_NOISE))
    return nonperiodic, int((nonperiodic_ratio if nonperiodic else periodic_ratio).argmax())


def _most_explained(side: LabelledComparison) -> int:
    """Channel of the residual map that explains most, for noise estimated from the residual itself."""
    channels = side.recording.channels
    best = residual_maps(side.comparison, dict.fromkeys(channels, 0.0))[0]
    return channels.index(best.channel)
