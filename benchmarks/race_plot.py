"""Race plot: the best ln det that each entrant had by when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmarks.rivals.trace import Trace
from truewrench.plots.style import INK, LEGEND, MUTED, SMALL, PanelGrid, panel_title

COLOURS = ("#0072B2", "#D55E00", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#8A8F98")
"""Okabe and Ito's, which colour-blind people can tell apart; ours first."""
WORST = 47.0
"""On the reference problem, what lies below is not drawn: the first steps of every search."""


def race_figure(
    raced: Sequence[Mapping[str, Trace]], *, problem: str = "Reference problem", worst: float = WORST
) -> Figure:
    """A line for each seed and entrant: ln det against seconds, which are logarithmic, to the end of its run.

    What lies below `worst` is not drawn, and named instead.
    """
    sheet = PanelGrid(rows=1, columns=1, panel_height=330, width=760, bottom=44)
    figure, panels = sheet.panels()
    axes = panels[0, 0]
    panel_title(axes, f"{problem}: the best feasible motion found by then")
    latest = max(trace.total_seconds for race in raced for trace in race.values())
    for colour, name in zip(COLOURS, raced[0], strict=False):
        for number, race in enumerate(raced):
            trace = race[name]
            if trace.best < worst:
                continue
            times = np.append(trace.seconds, trace.total_seconds)
            values = np.append(trace.logdet, trace.best)
            style = {"color": colour, "lw": 1.8 if name == next(iter(raced[0])) else 1.1, "alpha": 0.85}
            axes.step(times, values, where="post", label=None if number else name, **style)
            axes.plot(times[-1:], values[-1:], "o", ms=3, color=colour)
    axes.set_xscale("log")
    axes.set_xlim(0.02, 1.3 * latest)
    axes.set_ylim(worst, None)
    axes.set_xlabel("processor time (s)", color=INK)
    axes.set_ylabel("ln det of the information")
    left_out = [name for name in raced[0] if all(race[name].best < worst for race in raced)]
    if left_out:
        text = "below: " + ", ".join(f"{n} {np.median([race[n].best for race in raced]):.2f}" for n in left_out)
        axes.annotate(text, (0.99, 0.02), xycoords="axes fraction", ha="right", fontsize=SMALL, color=MUTED)
    axes.legend(**LEGEND, loc="upper left")
    return figure
