"""Posture plot: an arm along a motion, the path of its tip, and the box that the tip has to stay in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from numpy.typing import NDArray

from design.limit_use import Reach
from design.motion.series import Motion
from design.workspace import tip_path
from modeling.arm import PlanarArm
from modeling.kinematics import Arm
from truewrench.plots.number import figures
from truewrench.plots.share_plot import limits_text, touches, use_text
from truewrench.plots.style import FAILING, INK, MEASURED, NOISE, SMALL, heading

Array = NDArray[np.float64]

POSTURES = 5
POINTS = 800
AWAY = 13.0
"""Points from the tip to the middle of its label."""


def draw_postures(
    axes: Axes, motion: Motion, arm: Arm, tip_length: float, colours: tuple[Array, Colormap, Normalize] | None
) -> None:
    """The arm at a few instants, and the path of its tip, m; an arm in space from the side, x and z.

    colours: what the path is coloured by at equally spaced instants (N,) of one run, with its map and scale.
    """
    upward = 1 if isinstance(arm, PlanarArm) else 2
    if isinstance(arm, PlanarArm):
        _arms(axes, motion, arm, tip_length)
    tip = tip_path(motion, arm, tip_length, np.linspace(0.0, motion.period, POINTS))[:, [0, upward]]
    _path(axes, tip, colours)
    low, high = tip.min(axis=0), tip.max(axis=0)
    base = np.zeros(2) if isinstance(arm, PlanarArm) else low
    low, high = np.minimum(low, base), np.maximum(high, base)
    room = 0.12 * float((high - low).max())
    axes.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)" if upward == 1 else "z (m)")
    heading(axes, "the path of the tip" + (", and the arm" if upward == 1 else ", from the side"))


def draw_workspace(axes: Axes, reaches: Sequence[Reach], upward: str) -> None:
    """The sides that the tip is kept from, shaded beyond, red where it touches; `upward` is y or z."""
    drawn = {"x": axes.get_xlim(), upward: axes.get_ylim()}
    for reach in (reach for reach in reaches if reach.name in drawn):
        span, line = (axes.axvspan, axes.axvline) if reach.name == "x" else (axes.axhspan, axes.axhline)
        for limit, edge, side in zip(reach.limit, drawn[reach.name], ("low", "high"), strict=True):
            near = touches(reach) and side == reach.side
            if (edge < limit) == (side == "low"):
                span(edge, limit, color=NOISE, lw=0, zorder=0)
                line(limit, color=FAILING if near else INK, lw=2.0 if near else 0.9, zorder=1)


def write_workspace(axes: Axes, reaches: Sequence[Reach]) -> None:
    """Below the drawing a line for each side of the workspace: its limits, and how much of them is used."""
    for line, reach in enumerate(reaches):
        text = f"tip {reach.name}  {use_text(reach)} of {limits_text(reach)}"
        colour, weight = (FAILING, "bold") if touches(reach) else (INK, "normal")
        style: dict[str, Any] = {"textcoords": "offset points", "va": "top", "annotation_clip": False}
        style |= {"fontsize": SMALL, "color": colour, "fontweight": weight}
        axes.annotate(text, (0, 0), (0, -32 - 11 * line), axes.transAxes, **style)


def skeletons(arm: PlanarArm, tip_length: float, q: Array) -> Array:
    """Base, joints, sensor and tip (P, n + 2, 2), m, in postures q (P, n): arms that are cut off after each length."""
    ends = [np.zeros((2, len(q)))]
    for cut in range(1, arm.joints + 1):
        ends.append(np.array(PlanarArm(arm.link_lengths[:cut]).tip(0.0).map(len(q))(q[:, :cut].T)))
    ends.append(np.array(arm.tip(tip_length).map(len(q))(q.T)))
    return np.array(ends).transpose(2, 0, 1)


def apart(points: Array, count: int) -> list[int]:
    """Indices of so many points (N, 2), the first and then always the one farthest from those before."""
    chosen = [0]
    while len(chosen) < count:
        distance = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return chosen


def _arms(axes: Axes, motion: Motion, arm: PlanarArm, tip_length: float) -> None:
    time = np.linspace(0.0, motion.period, POINTS)
    shown = time[apart(tip_path(motion, arm, tip_length, time), POSTURES)]
    for at, bones in zip(shown, skeletons(arm, tip_length, motion.derivative(shown, 0)), strict=True):
        axes.plot(*bones.T, color=MEASURED, lw=1.5, alpha=0.55, solid_joinstyle="round", zorder=2)
        axes.plot(*bones[1:-1].T, "o", color=MEASURED, ms=3, zorder=2)
        axes.plot(*bones[-1], "o", color=INK, ms=3, zorder=5)
        along = bones[-1] - bones[0]
        beyond = AWAY * along / max(float(np.hypot(*along)), 1e-9)
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL, "color": INK, "zorder": 6}
        axes.annotate(f"{figures(float(at), 2)} s", bones[-1], tuple(beyond), textcoords="offset points", **style)
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
