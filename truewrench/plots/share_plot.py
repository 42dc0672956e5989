"""Share plot: what each joint does between its limits over a motion, and how much of them it uses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import argrelmax

from design.limit_use import LimitUse, Reach
from design.motion.series import Motion
from truewrench.plots.number import figures
from truewrench.plots.style import INK, MUTED, NOISE, SMALL, name_y

Array = NDArray[np.float64]

JOINT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#24292F")
"""Of the joints, again from the start after the seventh (Okabe and Ito)."""
TOUCHED = 0.995
"""A limit that is used to within half a percent is shown as touched: less cannot be seen."""
POINTS = 2000
LINE = 12.5
"""Height of a line of small text, CSS pixels."""


def joint_colour(index: int) -> str:
    """The colour of a joint, counted from 0."""
    return JOINT_COLOURS[index % len(JOINT_COLOURS)]


def touches(reach: Reach) -> bool:
    """Whether the nearest limit is used up, as far as can be seen."""
    return reach.use > TOUCHED


def draw_shares(axes: Axes, motion: Motion, order: int, reaches: Sequence[Reach]) -> None:
    """The derivative of an order of each joint from its lower limit (-1) to its upper one (1); a dot where it touches.

    reaches are the joints', one each; what lies beyond the limits is shaded.
    """
    time = np.linspace(0.0, motion.period, POINTS)
    values = motion.derivative(time, order)
    middle, half = (np.array([sign * r.limit[0] + r.limit[1] for r in reaches]) / 2 for sign in (1, -1))
    shares = (values - middle) / half
    reach = max(1.16, 1.05 * float(np.abs(shares).max()))
    for side in (-1, 1):
        axes.axhspan(side, 2 * side * reach, color=NOISE, lw=0, zorder=0)
        axes.axhline(side, color=INK, lw=0.9, zorder=1)
    axes.axhline(0, color=MUTED, lw=0.4, zorder=0.5)
    for joint, share in enumerate(shares.T):
        axes.plot(time, share, color=joint_colour(joint), lw=1.3, zorder=2)
        at = touched_at(share)
        axes.plot(
            time[at], share[at], "o", color=joint_colour(joint), mec="white", mew=0.6, ms=5, zorder=3, clip_on=False
        )
    axes.set_ylim(-reach, reach)
    axes.set_xlim(0, motion.period)
    axes.set_yticks([-1, 0, 1], ["low", "middle", "high"])
    name_y(axes, reaches[0].quantity)


def touched_at(share: Array) -> NDArray[np.intp]:
    """Where a share of the limits is largest, locally, and touches one of them."""
    size = np.abs(share)
    tops = argrelmax(size, order=POINTS // 100, mode="wrap")[0]
    return np.asarray(tops[size[tops] > TOUCHED], dtype=np.intp)


def write_uses(axes: Axes, reaches: Sequence[Reach], width: float, height: float) -> None:
    """To the right of the axes (CSS pixels) a line for each joint: its limits, and how much of them is used."""
    for line, reach in enumerate(reaches):
        up = 1 - (line + 0.5) * LINE / height
        style: dict[str, Any] = {"transform": axes.transAxes, "va": "center", "fontsize": SMALL}
        style |= {"color": joint_colour(line), "fontweight": "bold" if touches(reach) else "normal"}
        axes.text(1 + 12 / width, up, reach.name, **style)
        axes.text(1 + 79 / width, up, use_text(reach), ha="right", **style)
        axes.text(1 + 86 / width, up, f"of {limits_text(reach)}", **style)


def use_text(reach: Reach) -> str:
    """The use in per cent."""
    return f"{100 * reach.use:.1f} %"


def limits_text(reach: Reach) -> str:
    """Limits with their unit, "± 2 rad/s" where they are symmetric."""
    low, high = reach.limit
    span = f"± {figures(high)}" if low == -high else f"{figures(low)} to {figures(high)}"
    return f"{span} {reach.unit}"


def of_quantity(use: LimitUse, quantity: str) -> tuple[Reach, ...]:
    """The reaches of one quantity."""
    return tuple(reach for reach in use.reaches if reach.quantity == quantity)
