"""Exciting trajectory: joint limits, tip path, Fisher information per sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import argrelmax

from design.information.sample_information import SampleInformation
from design.limits import LIMITED_DERIVATIVES, LimitedQuantity, LimitUse, tip_path
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm, PlanarArm
from modeling.number_format import format_number
from modeling.rig import Limits, Workspace
from truewrench.plots.style import (
    FAINT,
    INK,
    MEASURED,
    MISFIT_COLOUR,
    MUTED,
    NOISE,
    SMALL,
    WIDTH,
    PixelLayout,
    label_y_axis,
    panel_title,
)

# Fisher information per sample, total and per parameter.


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


# Joint position, velocity and acceleration relative to their limits.


JOINT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#24292F")
"""Of the joints, cyclic (Okabe and Ito)."""
ACTIVE_USE = 0.995
"""Use of a limit above which it is marked as active: half a percent is not visible."""
PLOT_POINTS = 2000
LINE_HEIGHT = 12.5
"""Height of a line of small text, CSS pixels."""


def joint_colour(index: int) -> str:
    """Colour of a joint, counted from 0."""
    return JOINT_COLOURS[index % len(JOINT_COLOURS)]


def is_active(limited: LimitedQuantity) -> bool:
    """Whether the nearest limit is active."""
    return limited.use > ACTIVE_USE


def draw_limit_use(axes: Axes, motion: Trajectory, order: int, limited_quantities: Sequence[LimitedQuantity]) -> None:
    """Derivative of an order of each joint from its lower (-1) to its upper limit (1); a dot where active.

    limited_quantities: one per joint; the region beyond the limits is shaded.
    """
    time = np.linspace(0.0, motion.period, PLOT_POINTS)
    values = motion.derivative(time, order)
    middle, half = (np.array([sign * r.limit[0] + r.limit[1] for r in limited_quantities]) / 2 for sign in (1, -1))
    shares = (values - middle) / half
    extent = max(1.16, 1.05 * float(np.abs(shares).max()))
    for side in (-1, 1):
        axes.axhspan(side, 2 * side * extent, color=NOISE, lw=0, zorder=0)
        axes.axhline(side, color=INK, lw=0.9, zorder=1)
    axes.axhline(0, color=MUTED, lw=0.4, zorder=0.5)
    for joint, share in enumerate(shares.T):
        axes.plot(time, share, color=joint_colour(joint), lw=1.3, zorder=2)
        at = active_instants(share)
        axes.plot(
            time[at], share[at], "o", color=joint_colour(joint), mec="white", mew=0.6, ms=5, zorder=3, clip_on=False
        )
    axes.set_ylim(-extent, extent)
    axes.set_xlim(0, motion.period)
    axes.set_yticks([-1, 0, 1], ["low", "middle", "high"])
    label_y_axis(axes, limited_quantities[0].quantity)


def active_instants(share: Array) -> NDArray[np.intp]:
    """Indices of local maxima of the use where a limit is active."""
    size = np.abs(share)
    tops = argrelmax(size, order=PLOT_POINTS // 100, mode="wrap")[0]
    return np.asarray(tops[size[tops] > ACTIVE_USE], dtype=np.intp)


def write_limit_use(axes: Axes, limited_quantities: Sequence[LimitedQuantity], width: float, height: float) -> None:
    """To the right of the axes (CSS pixels) a line per joint: its limits and their use."""
    for line, limited in enumerate(limited_quantities):
        up = 1 - (line + 0.5) * LINE_HEIGHT / height
        style: dict[str, Any] = {"transform": axes.transAxes, "va": "center", "fontsize": SMALL}
        style |= {"color": joint_colour(line), "fontweight": "bold" if is_active(limited) else "normal"}
        axes.text(1 + 12 / width, up, limited.name, **style)
        axes.text(1 + 79 / width, up, limit_use_text(limited), ha="right", **style)
        axes.text(1 + 86 / width, up, f"of {limits_text(limited)}", **style)


def limit_use_text(limited: LimitedQuantity) -> str:
    """Use of a limit in per cent."""
    return f"{100 * limited.use:.1f} %"


def limits_text(limited: LimitedQuantity) -> str:
    """Limits with their unit, "± 2 rad/s" where they are symmetric."""
    low, high = limited.limit
    span = f"± {format_number(high)}" if low == -high else f"{format_number(low)} to {format_number(high)}"
    return f"{span} {limited.unit}"


def limits_of_quantity(use: LimitUse, quantity: str) -> tuple[LimitedQuantity, ...]:
    """The limited quantities of one derivative or of the workspace."""
    return tuple(q for q in use.limited_quantities if q.quantity == quantity)


# Arm postures, tip path and workspace limits.


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


LEFT, TIME, USES, RIGHT = 78, 374, 266, 10
"""CSS pixels: axis labels, panels over time, text to their right, right margin."""
TOP, SHARES, TOTAL, BETWEEN, HEAD, BOTTOM = 26, 104, 78, 14, 34, 40
"""CSS pixels: margins, panel heights, the space between panels and above a heading."""


def trajectory_figure(
    motion: Trajectory,
    limits: Limits,
    *,
    arm: Arm | None = None,
    tip_length: float | None = None,
    workspace: Workspace | None = None,
    information: SampleInformation | None = None,
) -> Figure:
    """Joints relative to their limits, information per sample, and tip path (with postures of a planar arm).

    Without an arm there is no path, without `information` no panels of it; tip_length in m, 0 when None.
    """
    use = LimitUse.of(motion, limits, workspace, arm, tip_length)
    quantities = [quantity for quantity in LIMITED_DERIVATIVES if limits_of_quantity(use, quantity)]
    share = max(SHARES, LINE_HEIGHT * (motion.joints + 1))
    middle = TOP + len(quantities) * (share + BETWEEN) - BETWEEN
    information_height = 0.0 if information is None else HEAD + TOTAL + BETWEEN + ROW_HEIGHT * len(information.names)
    page = PixelLayout.of(middle + information_height + BOTTOM)

    panels = [page.panel(LEFT, TOP + i * (share + BETWEEN), TIME, share) for i in range(len(quantities))]
    for axes, quantity in zip(panels, quantities, strict=True):
        draw_limit_use(axes, motion, list(LIMITED_DERIVATIVES).index(quantity), limits_of_quantity(use, quantity))
        write_limit_use(axes, limits_of_quantity(use, quantity), TIME, share)
    panel_title(panels[0], "joint limits and their largest use")
    if information is not None:
        panels += _information_panels(page, motion, information, middle + HEAD)
    if arm is not None:
        _tip_path_panel(page, motion, arm, tip_length or 0.0, use, information, middle)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
    return page.figure


def _information_panels(
    page: PixelLayout, motion: Trajectory, information: SampleInformation, top: float
) -> list[Axes]:
    total = page.panel(LEFT, top, TIME, TOTAL)
    rows = ROW_HEIGHT * len(information.names)
    strip = page.panel(LEFT, top + TOTAL + BETWEEN, TIME, rows)
    draw_information(total, motion, information)
    draw_parameter_information(strip, motion, information)
    draw_colour_bar(page.panel(LEFT + TIME + 16, top + TOTAL + BETWEEN, 8, rows))
    return [total, strip]


def _tip_path_panel(
    page: PixelLayout,
    motion: Trajectory,
    arm: Arm,
    tip_length: float,
    use: LimitUse,
    information: SampleInformation | None,
    bottom: float,
) -> None:
    left, limited_quantities = LEFT + TIME + USES, limits_of_quantity(use, "workspace")
    axes = page.panel(left, TOP, WIDTH - left - RIGHT, bottom - TOP)
    draw_postures(axes, motion, arm, tip_length, None if information is None else information_colours(information))
    draw_workspace(axes, limited_quantities, "y" if isinstance(arm, PlanarArm) else "z")
    write_workspace_limits(axes, limited_quantities)
