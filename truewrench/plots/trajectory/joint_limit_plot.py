"""Joint position, velocity and acceleration relative to their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import argrelmax

from design.limits.limit_use import LimitedQuantity, LimitUse
from design.trajectories.trajectory import Trajectory
from modeling.number_format import format_number
from truewrench.plots.style import INK, MUTED, NOISE, SMALL, label_y_axis

Array = NDArray[np.float64]

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
