"""Histogram of a clock's sampling intervals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from estimation.recordings.reports.reading_report import ClockReading
from truewrench.plots.style import ADEQUATE_COLOUR, INK, SMALL, panel_title

LONGEST_NAME = 30
SMALLEST_JITTER = 1e-6
"""Seconds; less is rounding of the stamps."""


def draw_intervals(axes: Axes, clock: ClockReading) -> None:
    """Intervals between neighbouring stamps, with how many are zero, negative or too long for the axis."""
    panel_title(axes, "sampling intervals")
    found = clock.intervals
    if found is None:
        return
    scale, unit = (1e3, "ms") if found.edges[-1] < 10 else (1.0, "s")
    axes.stairs(np.maximum(found.counts, 0.5), found.edges * scale, color=ADEQUATE_COLOUR, fill=True, baseline=0.5)
    axes.set(xlabel=f"interval between stamps ({unit})", ylabel="samples", yscale="log", ylim=(0.5, None))
    axes.set_ylim(0.5, 6 * float(found.counts.max(initial=1)))  # leaves room for the text
    axes.set_xlim(0, float(found.edges[-1]) * scale)
    jitter = f"jitter {clock.jitter * 1e3:.2g} ms" if clock.jitter > SMALLEST_JITTER else "no jitter"
    lines = [_shortened(clock.where), f"{clock.rate:.6g} Hz, {jitter}"]
    lines += [f"{found.longer} longer than {found.edges[-1] * scale:.3g} {unit}"] if found.longer else []
    lines += [f"{found.not_increasing} zero or negative"] if found.not_increasing else []
    place = {"transform": axes.transAxes, "ha": "right", "va": "top"}
    axes.text(0.99, 0.97, "\n".join(lines), fontsize=SMALL, color=INK, **place)  # type: ignore[arg-type]


def _shortened(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"..{name[-LONGEST_NAME + 2 :]}"
