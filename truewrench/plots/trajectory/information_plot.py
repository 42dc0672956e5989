"""Fisher information per sample, total and per parameter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from design.information.sample_information import SampleInformation
from design.trajectories.trajectory import Trajectory
from truewrench.plots.style import FAINT, INK, MUTED, SMALL, label_y_axis, panel_title

Array = NDArray[np.float64]

INFORMATION_COLOURMAP = LinearSegmentedColormap.from_list("information", ["#ECEEF2", "#C3B1E1", "#8250B8", "#3B0F6F"])
COLOUR_LIMIT = 3.0
"""Relative information (mean sample = 1) of the darkest colour; larger values are clipped."""
COLOUR_SCALE = Normalize(0.0, COLOUR_LIMIT, clip=True)
ROW_HEIGHT = 15
"""Height of a parameter's row, CSS pixels."""


def information_colours(information: SampleInformation) -> tuple[Array, Colormap, Normalize]:
    """Information of each sample relative to the mean, with colour map and scale, for the tip's path."""
    return information.total / information.total.mean(), INFORMATION_COLOURMAP, COLOUR_SCALE


def draw_information(axes: Axes, motion: Trajectory, information: SampleInformation) -> None:
    """tr(M^-1 S' S) of each sample over its mean, k / N: above one, more information than the mean sample."""
    time = motion.series.instants(len(information.total))
    share = information.total / information.total.mean()
    axes.fill_between(time, share, step="mid", color=INFORMATION_COLOURMAP(0.45), alpha=0.6, lw=0)
    axes.step(time, share, where="mid", color=INFORMATION_COLOURMAP(0.8), lw=1.0)
    axes.axhline(1.0, color=MUTED, lw=0.8, ls=(0, (4, 2)))
    axes.text(1.008, 1.0, "mean", transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL, color=MUTED)
    axes.set_ylim(0, 1.08 * float(share.max()))
    axes.set_xlim(0, motion.period)
    panel_title(axes, "Fisher information per sample, relative to the mean sample")
    label_y_axis(axes, "total")


def draw_parameter_information(axes: Axes, motion: Trajectory, information: SampleInformation) -> None:
    """A row per parameter: each sample's share in the information on it, relative to the mean."""
    shares = information.by_parameter * len(information.total)
    count = len(information.names)
    extent = (0.0, motion.period, count - 0.5, -0.5)
    axes.imshow(
        shares.T, aspect="auto", cmap=INFORMATION_COLOURMAP, norm=COLOUR_SCALE, extent=extent, interpolation="nearest"
    )
    axes.hlines(np.arange(1, count) - 0.5, 0, motion.period, color="white", lw=1.2)
    axes.set_yticks(range(count), information.names, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def draw_colour_bar(axes: Axes) -> None:
    """Colour bar."""
    figure = axes.get_figure(root=True)
    if figure is not None:
        bar = figure.colorbar(
            ScalarMappable(COLOUR_SCALE, INFORMATION_COLOURMAP), cax=axes, ticks=[0, 1, 2, COLOUR_LIMIT]
        )
        bar.outline.set_visible(False)
        axes.set_yticklabels(["0", "mean sample", "2 ×", f"≥ {COLOUR_LIMIT:.0f} ×"])
        axes.tick_params(colors=MUTED, labelsize=SMALL, length=2.5, width=0.6, color=FAINT)
