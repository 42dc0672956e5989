"""Exciting trajectory: use of every limit over time, Fisher information per sample and accumulated, and the arm."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten, wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray
from scipy.signal import argrelmax

from design.information.sample_information import SampleInformation
from design.joint_torque import joint_torques
from design.limits import LIMITED_DERIVATIVES, LimitedQuantity, LimitUse, tip_path, workspace_sides
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm, PlanarArm
from modeling.number_format import format_number
from modeling.rig import Limits, Workspace
from truewrench.plots.arm_plot import (
    FROM_ABOVE,
    FROM_THE_SIDE,
    PLANE,
    ArmInMotion,
    View,
    changing_clearances,
    draw_arm,
)
from truewrench.plots.style import (
    FAINT,
    INK,
    MISFIT_COLOUR,
    MUTED,
    NOISE,
    PIXELS_PER_INCH,
    SMALL,
    WIDTH,
    PixelLayout,
    label_y_axis,
    panel_title,
    style_axes,
)

# Fisher information per sample, total and per parameter, and accumulated.


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
    panel_title(axes, "Fisher information per sample, relative to the mean", room=1.4)
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


EARLY = 0.1
"""Share of the samples before which the accumulated information, which grows from nothing, does not set the scale."""
LEAST_SPAN = 1e-3
"""Of the least value, the smallest range that is drawn."""
DECADE = 10.0
"""Ratio of the largest to the least condition from which on its scale is logarithmic."""


def draw_accumulated(axes: Axes, motion: Trajectory, information: SampleInformation) -> None:
    """ln det of the information of the samples so far, and on the right the condition of their sensitivities."""
    time = motion.series.instants(len(information.total))
    right = style_axes(axes.twinx())
    right.spines[["left", "bottom"]].set_visible(False)
    logdet, condition = information.accumulated
    known = np.isfinite(logdet)
    late = known & (time >= EARLY * motion.period)
    for each, values, colour in ((right, condition, MUTED), (axes, logdet, INFORMATION_COLOURMAP(0.8))):
        each.plot(time[known], values[known], color=colour, lw=1.3)
        if late.any():
            low, high = values[late].min(), values[late].max()
            each.set_ylim(low, max(high, low + LEAST_SPAN * abs(low)))
    if late.any() and condition[late].max() > DECADE * condition[late].min():
        right.set_yscale("log")
        right.yaxis.set(major_locator=LogLocator(subs=(1, 3)), minor_locator=NullLocator())
        right.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlim(0, motion.period)
    panel_title(axes, "information accumulated")
    label_y_axis(axes, "ln det")
    right.set_ylabel("condition", color=MUTED, fontsize=SMALL)


# Limits: joints, torques, the tip and clearances.


JOINT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#24292F")
"""Of the joints, cyclic (Okabe and Ito)."""
ACTIVE_USE = 0.995
"""Use of a limit above which it is marked as active: half a percent is not visible."""
PLOT_POINTS = 2000
SHOWN_CLEARANCES = 6
"""The smallest: each is a line."""
LONGEST_NAME = 28
"""Characters of what is kept apart."""
LINE_HEIGHT = 12.5
"""Height of a line of small text, CSS pixels."""


def joint_colour(index: int) -> str:
    """Colour of a joint, counted from 0."""
    return JOINT_COLOURS[index % len(JOINT_COLOURS)]


def is_active(limited: LimitedQuantity) -> bool:
    """Whether the nearest limit is active."""
    return limited.use > ACTIVE_USE


def draw_limit_use(axes: Axes, time: Array, values: Array, limited_quantities: Sequence[LimitedQuantity]) -> None:
    """Values (N, S) at times (N,) from their lower (-1) to their upper limit (1); a dot where active."""
    middle, half = (np.array([sign * r.limit[0] + r.limit[1] for r in limited_quantities]) / 2 for sign in (1, -1))
    shares = (values - middle) / half
    for joint, share in enumerate(shares.T):
        axes.plot(time, share, color=joint_colour(joint), lw=1.3, zorder=2)
        at = active_instants(share)
        axes.plot(
            time[at], share[at], "o", color=joint_colour(joint), mec="white", mew=0.6, ms=5, zorder=3, clip_on=False
        )


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


def limited_values(motion: Trajectory, moved: ArmInMotion | None, quantity: str, time: Array) -> Array | None:
    """(N, S) at the times (N,), in the order of its limited quantities; None of a quantity that is not known here."""
    if quantity in LIMITED_DERIVATIVES:
        return motion.derivative(time, list(LIMITED_DERIVATIVES).index(quantity))
    if moved is not None and quantity == "torque" and (torques := joint_torques(moved.limits, moved.arm)) is not None:
        return torques.values(*motion.evaluate(time))
    if moved is None or quantity != "workspace":
        return None
    index = [at for at, _ in workspace_sides(moved.workspace, moved.arm).values()]
    return tip_path(motion, moved.arm, moved.tip_length, time)[:, index]


def draw_ranges(axes: Axes, limited_quantities: Sequence[LimitedQuantity]) -> None:
    """Of quantities whose course is not known here, the highest and the lowest as levels, from low (-1) to high (1)."""
    for line, limited in enumerate(limited_quantities):
        middle, half = sum(limited.limit) / 2, (limited.limit[1] - limited.limit[0]) / 2
        for value in (limited.low, limited.high):
            axes.axhline((value - middle) / half, color=joint_colour(line), lw=1.0, ls=(0, (4, 2)), zorder=2)


def draw_clearances(axes: Axes, moved: ArmInMotion, time: Array, height: float) -> None:
    """The smallest clearances beyond what is asked for, m; on the right which they are, and the least of each."""
    if (asked := moved.clearances) is None:
        return
    values = asked.values(moved.motion.derivative(time, 0))
    changing = changing_clearances(values)
    nearest = changing[values[:, changing].min(axis=0).argsort()][:SHOWN_CLEARANCES]
    for line, which in enumerate(nearest):
        at, colour = int(values[:, which].argmin()), joint_colour(line)
        axes.plot(time, values[:, which], color=colour, lw=1.3, zorder=2)
        axes.plot(time[at], values[at, which], "o", color=colour, mec="white", mew=0.6, ms=5, zorder=3, clip_on=False)
        style: dict[str, Any] = {"transform": axes.transAxes, "va": "center", "fontsize": SMALL, "color": colour}
        up = 1 - (line + 0.5) * LINE_HEIGHT / height
        axes.text(1 + 62 / TIME, up, f"{1000 * values[at, which]:.1f} mm", ha="right", **style)
        axes.text(1 + 70 / TIME, up, shorten(asked.names[which], LONGEST_NAME, placeholder=" .."), **style)
    if len(asked.names) > len(nearest):
        more = len(asked.names) - len(nearest)
        text = f"and {more} more, larger or unchanging" if len(nearest) else f"{more}, unchanging"
        up = 1 - (len(nearest) + 0.5) * LINE_HEIGHT / height
        axes.text(1 + 12 / TIME, up, text, transform=axes.transAxes, va="center", fontsize=SMALL, color=MUTED)
    top = 1.08 * float(values[:, nearest if len(nearest) else slice(None)].max())
    axes.set_ylim(-0.12 * top, top)
    axes.axhspan(-top, 0.0, color=NOISE, lw=0, zorder=0)
    axes.axhline(0, color=INK, lw=0.9, zorder=1)
    label_y_axis(axes, "clearance (m)")


def limits_of_quantity(use: LimitUse, quantity: str) -> tuple[LimitedQuantity, ...]:
    """The limited quantities of one derivative or of the workspace."""
    return tuple(q for q in use.limited_quantities if q.quantity == quantity)


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


# The figure: limits and information over time on the left, the arm on the right.


LEFT, TIME, USES, RIGHT = 78, 374, 266, 10
"""CSS pixels: axis labels, panels over time, text to their right, right margin."""
TOP, SHARES, TOTAL, BETWEEN, HEAD, BOTTOM = 26, 104, 78, 14, 34, 40
"""CSS pixels: margins, panel heights, the space between panels and above a heading."""
VIEW, BELOW, NOTE = 330, 74, 14
"""CSS pixels: height of a view of a spatial arm, what is below it to the next one, and a line of a note."""
NOTE_CHARACTERS = 66
"""Of a line of a note."""


def trajectory_figure(
    motion: Trajectory,
    limits: Limits,
    *,
    arm: Arm | None = None,
    tip_length: float | None = None,
    workspace: Workspace | None = None,
    information: SampleInformation | None = None,
    notes: Sequence[str] = (),
) -> Figure:
    """Limits and their use, information, and the arm with the path of its tip; `notes` are written below it.

    Without an arm there is none, without `information` no panels of it; tip_length in m, 0 when None.
    """
    use = LimitUse.of(motion, limits, workspace, arm, tip_length)
    moved = None
    if arm is not None:
        moved = ArmInMotion(motion=motion, arm=arm, tip_length=tip_length or 0.0, limits=limits, workspace=workspace)
    counts = {name: len(limits_of_quantity(use, name)) for name in use.by_quantity}
    if "clearance" in counts:
        counts["clearance"] = SHOWN_CLEARANCES
    heights = {name: max(SHARES, LINE_HEIGHT * (count + 1)) for name, count in counts.items()}
    middle = TOP + sum(heights.values()) + BETWEEN * (len(heights) - 1)
    below = 0.0 if information is None else 2 * (HEAD + TOTAL) + BETWEEN + ROW_HEIGHT * len(information.names)
    views = () if arm is None else (PLANE,) if isinstance(arm, PlanarArm) else (FROM_THE_SIDE, FROM_ABOVE)
    beside = len(views) * (VIEW + BELOW) + NOTE * len(_notes(moved, notes)) if len(views) > 1 else 0.0
    page = PixelLayout.of(max(middle + below + BOTTOM, TOP + beside))

    panels, top = list[Axes](), float(TOP)
    for name, height in heights.items():
        panels.append(page.panel(LEFT, top, TIME, height))
        _limit_panel(panels[-1], motion, moved, limits_of_quantity(use, name), height)
        top += height + BETWEEN
    panel_title(panels[0], "limits and their largest use")
    if information is not None:
        panels += _information_panels(page, motion, information, middle + HEAD)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
    if moved is not None:
        _arm_panels(page, moved, views, limits_of_quantity(use, "workspace"), information, middle - TOP, notes)
    return page.figure


def _limit_panel(
    axes: Axes, motion: Trajectory, moved: ArmInMotion | None, limited: Sequence[LimitedQuantity], height: float
) -> None:
    time, quantity = np.linspace(0.0, motion.period, PLOT_POINTS), limited[0].quantity
    axes.set_xlim(0, motion.period)
    if quantity == "clearance" and moved is not None:
        draw_clearances(axes, moved, time, height)
        return
    values = limited_values(motion, moved, quantity, time)
    if values is None:
        draw_ranges(axes, limited)
    else:
        draw_limit_use(axes, time, values, limited)
    extent = max(1.16, *(1.05 * each.use for each in limited))
    for side in (-1, 1):
        axes.axhspan(side, 2 * side * extent, color=NOISE, lw=0, zorder=0)
        axes.axhline(side, color=INK, lw=0.9, zorder=1)
    axes.axhline(0, color=MUTED, lw=0.4, zorder=0.5)
    axes.set_ylim(-extent, extent)
    axes.set_yticks([-1, 0, 1], ["low", "middle", "high"])
    label_y_axis(axes, "tip" if quantity == "workspace" else quantity)
    write_limit_use(axes, limited, TIME, height)


def _information_panels(
    page: PixelLayout, motion: Trajectory, information: SampleInformation, top: float
) -> list[Axes]:
    total = page.panel(LEFT, top, TIME, TOTAL)
    rows = ROW_HEIGHT * len(information.names)
    strip = page.panel(LEFT, top + TOTAL + BETWEEN, TIME, rows)
    accumulated = page.panel(LEFT, top + TOTAL + BETWEEN + rows + HEAD, TIME, TOTAL)
    draw_information(total, motion, information)
    draw_parameter_information(strip, motion, information)
    draw_colour_bar(page.panel(LEFT + TIME + 16, top + TOTAL + BETWEEN, 8, rows))
    draw_accumulated(accumulated, motion, information)
    return [total, strip, accumulated]


def _notes(moved: ArmInMotion | None, notes: Sequence[str]) -> list[str]:
    """Lines below the arm: its closest approach, and what else is said."""
    approach = None if moved is None else moved.approach
    closest = [] if approach is None else [str(approach)]
    return [line for note in (*closest, *notes) for line in wrap(note, NOTE_CHARACTERS)]


def _arm_panels(
    page: PixelLayout,
    moved: ArmInMotion,
    views: Sequence[View],
    limited: Sequence[LimitedQuantity],
    information: SampleInformation | None,
    height: float,
    notes: Sequence[str],
) -> None:
    left = LEFT + TIME + USES
    width, height = WIDTH - left - RIGHT, VIEW if len(views) > 1 else height
    for number, view in enumerate(views):
        axes = page.panel(left, TOP + number * (VIEW + BELOW), width, height)
        draw_arm(axes, moved, view, None if information is None else information_colours(information))
        draw_workspace(axes, limited, "xyz"[view.up])
        if view is views[-1]:
            _write_notes(axes, _notes(moved, notes))


def _write_notes(axes: Axes, lines: Sequence[str]) -> None:
    for line, text in enumerate(lines):
        down = -(0.75 * BELOW + line * NOTE) * 72 / PIXELS_PER_INCH
        axes.annotate(text, (0, 0), (0, down), "axes fraction", textcoords="offset points", fontsize=SMALL, color=INK)
