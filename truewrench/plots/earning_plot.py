"""Earning plot: when along a motion its information is earned, in all and by parameter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from design.motion.series import Motion
from design.sample_information import SampleInformation
from truewrench.plots.style import FAINT, INK, MUTED, SMALL, heading, name_y

Array = NDArray[np.float64]

EARNED = LinearSegmentedColormap.from_list("earned", ["#ECEEF2", "#C3B1E1", "#8250B8", "#3B0F6F"])
RICH = 3.0
"""Times the mean share of a sample that the darkest colour stands for; more is as dark."""
SCALE = Normalize(0.0, RICH, clip=True)
ROW_HEIGHT = 15
"""CSS pixels of a parameter."""


def path_colours(information: SampleInformation) -> tuple[Array, Colormap, Normalize]:
    """What the tip's path is coloured by: the shares of the samples, over their mean."""
    return information.total / information.total.mean(), EARNED, SCALE


def draw_total(axes: Axes, motion: Motion, information: SampleInformation) -> None:
    """tr(M^-1 S' S) of each sample over its mean, k / N: what is above one tells more than the average sample."""
    time = motion.series.instants(len(information.total))
    share = information.total / information.total.mean()
    axes.fill_between(time, share, step="mid", color=EARNED(0.45), alpha=0.6, lw=0)
    axes.step(time, share, where="mid", color=EARNED(0.8), lw=1.0)
    axes.axhline(1.0, color=MUTED, lw=0.8, ls=(0, (4, 2)))
    axes.text(1.008, 1.0, "mean", transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL, color=MUTED)
    axes.set_ylim(0, 1.08 * float(share.max()))
    axes.set_xlim(0, motion.period)
    heading(axes, "when the information is earned: each sample's share, as multiples of the mean sample's")
    name_y(axes, "in all")


def draw_earnings(axes: Axes, motion: Motion, information: SampleInformation) -> None:
    """A row for each parameter: the samples' shares in its variance, over their mean."""
    shares = information.by_parameter * len(information.total)
    count = len(information.names)
    extent = (0.0, motion.period, count - 0.5, -0.5)
    axes.imshow(shares.T, aspect="auto", cmap=EARNED, norm=SCALE, extent=extent, interpolation="nearest")
    axes.hlines(np.arange(1, count) - 0.5, 0, motion.period, color="white", lw=1.2)
    axes.set_yticks(range(count), information.names, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def draw_scale(axes: Axes) -> None:
    """The colours' scale."""
    figure = axes.get_figure(root=True)
    if figure is not None:
        bar = figure.colorbar(ScalarMappable(SCALE, EARNED), cax=axes, ticks=[0, 1, 2, RICH])
        bar.outline.set_visible(False)
        axes.set_yticklabels(["0", "mean sample", "2 ×", f"{RICH:.0f} × and more"])
        axes.tick_params(colors=MUTED, labelsize=SMALL, length=2.5, width=0.6, color=FAINT)
