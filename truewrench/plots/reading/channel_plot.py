"""Channels of a recording over time, with what was mended, what is suspicious, and the cuts between repeats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimation.recordings.reports.reading_curves import ReadingCurves, Span
from estimation.recordings.reports.reading_report import ReadingReport, ReadingStep, StepKind
from modeling.number_format import axis_label
from modeling.rig.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS
from truewrench.plots.reading.step_plot import COLOURS
from truewrench.plots.style import ADEQUATE_COLOUR, INK, LEGEND, QUIET_NOISE, SMALL

FEWEST_ROWS = 5
"""Panels below each other that auxiliary columns may fill, or as many as wrench or motion have; more are not drawn."""
LONGEST_NAME = 12
WIDE_SHARE = 0.3
"""Of the time: what was mended for longer, such as a held series, is marked above the channels alone."""
MARGIN = 0.01


def channel_columns(report: ReadingReport, curves: ReadingCurves) -> tuple[list[str], list[str]]:
    """Channels of the left and of the right column of panels: the wrench, and the motion; then what else there is."""
    wrench = [name for name in (*SPATIAL_CHANNELS, *PLANAR_CHANNELS) if name in curves.channels]
    targets = [target for used in report.used for target in used.targets]
    left = list(dict.fromkeys(wrench))
    right = [name for name in targets if name in curves.channels and name not in left]
    rows = max(len(left), len(right), FEWEST_ROWS)
    for name in curves.channels:
        if name in left or name in right:
            continue
        shorter = min((left, right), key=len)
        if len(shorter) < rows:
            shorter.append(name)
    return left, right


def time_limits(report: ReadingReport) -> Span:
    """The recording's time, and that of the steps, with a margin."""
    curves = report.curves
    ends = [end for step in report.steps for span in step.at for end in span]
    if curves is not None and curves.time is not None:
        ends += curves.time
    elif curves is not None:
        ends += [0.5, report.samples + 0.5]
    low, high = min(ends), max(ends)
    return low - MARGIN * (high - low), high + MARGIN * (high - low)


def draw_channels(panels: Sequence[Axes], names: Sequence[str], report: ReadingReport, curves: ReadingCurves) -> None:
    """One channel a panel, over the same time."""
    limits = time_limits(report)
    for axes, name in zip(panels, names, strict=True):
        x, y = curves.channels[name]
        axes.plot(x, y, color=INK, **_line(curves))
        axes.margins(y=0.1)
        _draw_left_out(axes, curves.time, limits)
        for step in report.steps:
            if _concerns(step, name, report, limits):
                bars = [(start, end - start) for start, end in step.at]
                colour = COLOURS[step.kind]
                across = axes.get_xaxis_transform()
                axes.broken_barh(bars, (0, 1), facecolor=colour, edgecolor=colour, lw=0.8, alpha=0.45, transform=across)
        for cut in curves.cuts:
            axes.axvline(cut, color=ADEQUATE_COLOUR, lw=0.8, ls=(0, (3, 2)), zorder=0.5)
        axes.set_xlim(*limits)
        axes.locator_params(axis="y", nbins=3)
        axes.ticklabel_format(axis="y", useOffset=False)
        label = axis_label(_shortened(name), curves.units.get(name, ""))
        if len(label) < LONGEST_NAME:
            axes.set_ylabel(label)
        else:
            axes.set_ylabel(label.replace(" (", "\n("), fontsize=SMALL - 1)
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[-1].set_xlabel("time (s)" if curves.time is not None else "pose, in the order of recording")


def _line(curves: ReadingCurves) -> dict[str, Any]:
    """Style of a channel: a line over time, or points of static poses."""
    return {"lw": 0.8} if curves.time is not None else {"ls": "none", "marker": "o", "ms": 3.0}


def _concerns(step: ReadingStep, name: str, report: ReadingReport, limits: Span) -> bool:
    if step.kind not in COLOURS or not step.at or (step.channels and name not in step.channels):
        return False
    if step.kind is StepKind.SUSPICIOUS and step.channels:
        return True
    sources = {used.source for used in report.used if name in used.targets}
    share = sum(end - start for start, end in step.at) / (limits[1] - limits[0])
    return step.where in (sources or {step.where}) and share < WIDE_SHARE


def _draw_left_out(axes: Axes, time: Span | None, limits: Span) -> None:
    if time is None:
        return
    for start, end in ((limits[0], time[0]), (time[1], limits[1])):
        if end - start > 2 * MARGIN * (limits[1] - limits[0]):
            axes.axvspan(start, end, color=QUIET_NOISE, lw=0, zorder=0)


def draw_colour_key(figure: Figure, report: ReadingReport, place: tuple[float, float]) -> None:
    """What the colours of the channels mean, of those that occur."""
    curves = report.curves
    assert curves is not None
    kinds = {step.kind for step in report.steps if step.at}
    entries: list[tuple[Line2D | Patch, str]] = [(Line2D([], [], color=INK, **_line(curves)), "recording")]
    words = {StepKind.MENDED: "mended", StepKind.SUSPICIOUS: "suspicious"}
    entries += [(Patch(color=COLOURS[kind]), text) for kind, text in words.items() if kind in kinds]
    limits = time_limits(report)
    if curves.time is not None and np.ptp(limits) > (1 + 5 * MARGIN) * np.ptp(curves.time):
        entries.append((Patch(color=QUIET_NOISE), "not in the recording"))
    if curves.cuts:
        entries.append(
            (Line2D([], [], color=ADEQUATE_COLOUR, lw=1, ls="--"), f"cut into {len(curves.cuts) + 1} repeats")
        )
    undrawn = len(curves.channels) - sum(map(len, channel_columns(report, curves)))
    if undrawn:
        entries.append((Line2D([], [], lw=0), f"{undrawn} of {len(curves.channels)} columns are not drawn"))
    handles, labels = zip(*entries, strict=True)
    figure.legend(handles, labels, **LEGEND, ncols=len(entries), loc="lower left", bbox_to_anchor=place, borderpad=0)


def _shortened(name: str) -> str:
    return name if len(name) < LONGEST_NAME else f"..{name[-LONGEST_NAME + 4 :]}"
