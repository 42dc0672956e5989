"""Arm postures, tip path and workspace limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from numpy.typing import NDArray

from design.limits.limit_use import LimitedQuantity
from design.limits.tip_workspace import tip_path
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm
from modeling.kinematics.planar_arm import PlanarArm
from modeling.number_format import format_number
from truewrench.plots.style import INK, MEASURED, MISFIT_COLOUR, NOISE, SMALL, panel_title
from truewrench.plots.trajectory.joint_limit_plot import is_active, limit_use_text, limits_text

Array = NDArray[np.float64]

POSTURES = 5
PATH_POINTS = 800
LABEL_DISTANCE = 13.0
"""Points from the tip to the centre of its label."""


def draw_postures(
    axes: Axes, motion: Trajectory, arm: Arm, tip_length: float, colours: tuple[Array, Colormap, Normalize] | None
) -> None:
    """The arm at a few instants and the path of its tip, m; a spatial arm from the side, x and z.

    colours: values along the path at equally spaced instants (N,) of one period, with colour map and scale.
    """
    upward = 1 if isinstance(arm, PlanarArm) else 2
    if isinstance(arm, PlanarArm):
        _arms(axes, motion, arm, tip_length)
    tip = tip_path(motion, arm, tip_length, np.linspace(0.0, motion.period, PATH_POINTS))[:, [0, upward]]
    _path(axes, tip, colours)
    low, high = tip.min(axis=0), tip.max(axis=0)
    base = np.zeros(2) if isinstance(arm, PlanarArm) else low
    low, high = np.minimum(low, base), np.maximum(high, base)
    margin = 0.12 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)" if upward == 1 else "z (m)")
    panel_title(axes, "tip path" + (" and arm postures" if upward == 1 else ", side view"))


def draw_workspace(axes: Axes, limited_quantities: Sequence[LimitedQuantity], upward: str) -> None:
    """Workspace limits of the tip, shaded beyond, red where active; `upward` is y or z."""
    drawn = {"x": axes.get_xlim(), upward: axes.get_ylim()}
    for limited in (q for q in limited_quantities if q.name in drawn):
        span, line = (axes.axvspan, axes.axvline) if limited.name == "x" else (axes.axhspan, axes.axhline)
        for limit, edge, side in zip(limited.limit, drawn[limited.name], ("low", "high"), strict=True):
            active = is_active(limited) and side == limited.side
            if (edge < limit) == (side == "low"):
                span(edge, limit, color=NOISE, lw=0, zorder=0)
                line(limit, color=MISFIT_COLOUR if active else INK, lw=2.0 if active else 0.9, zorder=1)


def write_workspace_limits(axes: Axes, limited_quantities: Sequence[LimitedQuantity]) -> None:
    """Below the axes a line per workspace coordinate: its limits and their use."""
    for line, limited in enumerate(limited_quantities):
        text = f"tip {limited.name}  {limit_use_text(limited)} of {limits_text(limited)}"
        colour, weight = (MISFIT_COLOUR, "bold") if is_active(limited) else (INK, "normal")
        style: dict[str, Any] = {"textcoords": "offset points", "va": "top", "annotation_clip": False}
        style |= {"fontsize": SMALL, "color": colour, "fontweight": weight}
        axes.annotate(text, (0, 0), (0, -32 - 11 * line), axes.transAxes, **style)


def link_positions(arm: PlanarArm, tip_length: float, q: Array) -> Array:
    """Base, joints, sensor and tip (P, n + 2, 2), m, in postures q (P, n), by arms truncated after each link."""
    ends = [np.zeros((2, len(q)))]
    for cut in range(1, arm.joints + 1):
        ends.append(np.array(PlanarArm(arm.link_lengths[:cut], arm.base).tip(0.0).map(len(q))(q[:, :cut].T)))
    ends.append(np.array(arm.tip(tip_length).map(len(q))(q.T)))
    return np.array(ends).transpose(2, 0, 1)


def farthest_points(points: Array, count: int) -> list[int]:
    """Indices of `count` points of (N, 2): the first, then each time the one farthest from those chosen."""
    chosen = [0]
    while len(chosen) < count:
        distance = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return chosen


def _arms(axes: Axes, motion: Trajectory, arm: PlanarArm, tip_length: float) -> None:
    time = np.linspace(0.0, motion.period, PATH_POINTS)
    shown = time[farthest_points(tip_path(motion, arm, tip_length, time), POSTURES)]
    for at, links in zip(shown, link_positions(arm, tip_length, motion.derivative(shown, 0)), strict=True):
        axes.plot(*links.T, color=MEASURED, lw=1.5, alpha=0.55, solid_joinstyle="round", zorder=2)
        axes.plot(*links[1:-1].T, "o", color=MEASURED, ms=3, zorder=2)
        axes.plot(*links[-1], "o", color=INK, ms=3, zorder=5)
        along = links[-1] - links[0]
        beyond = LABEL_DISTANCE * along / max(float(np.hypot(*along)), 1e-9)
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL, "color": INK, "zorder": 6}
        axes.annotate(f"{format_number(float(at), 2)} s", links[-1], tuple(beyond), textcoords="offset points", **style)
    axes.plot(0, 0, "s", color=INK, ms=6, zorder=4)


def _path(axes: Axes, tip: Array, colours: tuple[Array, Colormap, Normalize] | None) -> None:
    if colours is None:
        axes.plot(*tip.T, color=INK, lw=2.0, zorder=3)
        return
    values, cmap, norm = colours
    pieces = np.stack([tip[:-1], tip[1:]], axis=1)
    nearest = (np.arange(len(pieces)) * len(values)) // len(pieces)
    lines = LineCollection(list(pieces), array=values[nearest], cmap=cmap, norm=norm, lw=3.0, zorder=3)
    lines.set_capstyle("round")
    axes.add_collection(lines)
