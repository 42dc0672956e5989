"""Directions that gravity took in the sensor's axes: on the sphere seen from both sides, in the plane on the circle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from truewrench.plots.style import ADEQUATE_COLOUR, FAINT, INK, MEASURED, SMALL, panel_title

Array = NDArray[np.float64]
FEW = 100
"""Directions that are drawn larger."""


def draw_gravity_directions(views: Sequence[Axes], gravity: Array) -> None:
    """Unit vectors (k, 3) on two views of the sphere, or (k, 2) on one circle."""
    spread = np.linalg.svd(gravity - gravity.mean(axis=0), compute_uv=False) / np.sqrt(len(gravity))
    if gravity.shape[1] == 2:
        _draw_view(views[0], gravity, np.ones(len(gravity), dtype=bool), 1.0)
        panel_title(views[0], "gravity in the sensor")
    else:
        for axes, side in zip(views, (1.0, -1.0), strict=True):
            _draw_view(axes, gravity, side * gravity[:, 2] >= 0, side)
            panel_title(axes, f"gravity, seen from {'+' if side > 0 else '-'}z")
    text = "std of its directions: " + ", ".join(f"{value:.2f}" for value in spread) + " g"
    views[0].text(0.0, -0.25, text, transform=views[0].transAxes, fontsize=SMALL, color=INK, va="top")


def _draw_view(axes: Axes, gravity: Array, near: NDArray[np.bool_], side: float) -> None:
    """The near half in colour, the far half pale; seen from -z, x runs to the left."""
    axes.add_patch(Circle((0, 0), 1, facecolor="none", edgecolor=FAINT, lw=0.9))
    axes.axhline(0, color=FAINT, lw=0.6, zorder=0)
    axes.axvline(0, color=FAINT, lw=0.6, zorder=0)
    axes.plot(*gravity[~near, :2].T, ".", color=MEASURED, ms=2.0, alpha=0.35)
    size = 3.2 if len(gravity) > FEW else 7.0
    axes.plot(*gravity[near, :2].T, ".", color=ADEQUATE_COLOUR, ms=size, alpha=0.8)
    axes.set(xlim=(-1.08 * side, 1.08 * side), ylim=(-1.08, 1.08), aspect="equal")
    axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], xlabel="along the sensor's x (g)", ylabel="along y (g)")
