"""Survey plot: verdicts, errors and sizes over the times of many recordings, one panel below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure
from numpy.typing import NDArray

from truewrench.plots.number import labelled
from truewrench.plots.style import FAILING, FAINT, HOLDING, INK, LEGEND, Sheet, heading

Array = NDArray[np.float64]

PANEL = 92
"""Height of a panel in CSS pixels."""
ROOM = 0.02
"""Of the time shown, left free at both ends."""
FORMATS = ["%Y", "%b %Y", "%d %b", "%H:%M", "%H:%M", "%H:%M:%S"]
ZERO_FORMATS = ["%Y", "%b %Y", "%d %b", "%d %b", "%H:%M", "%H:%M:%S"]
"""Of ticks at years, months, days, hours, minutes, seconds; and of those that begin the next larger unit."""


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Which recordings are in which class, such as a verdict: a label, a colour and the times."""

    label: str
    colour: str
    moments: Sequence[datetime]


@dataclass(frozen=True, kw_only=True)
class Course:
    """A quantity over time with its std; hollow where `sure` is false. `levels` is a change drawn through it."""

    title: str
    unit: str
    moments: Sequence[datetime]
    value: Array
    std: Array
    sure: NDArray[np.bool_]
    levels: Sequence[tuple[datetime, float]] = ()


@dataclass(frozen=True, kw_only=True)
class Fall:
    """An error over time before and after the effects were added."""

    title: str
    unit: str
    moments: Sequence[datetime]
    before: Array
    after: Array


def survey_figure(marks: Sequence[Marks], fall: Fall | None, courses: Sequence[Course]) -> Figure:
    """The panels, on one axis of time."""
    panels: list[Callable[[Axes], None]] = [lambda axes: _draw_marks(axes, marks)]
    if fall is not None:
        panels.append(lambda axes: _draw_fall(axes, fall))
    panels += [lambda axes, course=course: _draw_course(axes, course) for course in courses]  # type: ignore[misc]
    heights = [max(0.35, 0.22 * len(marks)), *[1.0] * (len(panels) - 1)]
    sheet = Sheet(rows=len(panels), columns=1, panel_height=PANEL, left=128, between_rows=34)
    figure, grid = sheet.panels(heights=heights, sharex=True)
    for draw, axes in zip(panels, grid[:, 0], strict=True):
        draw(axes)
    _date_axis(grid[-1, 0], [m for mark in marks for m in mark.moments])
    return figure


def _draw_marks(axes: Axes, marks: Sequence[Marks]) -> None:
    heading(axes, "verdict")
    for line, mark in enumerate(marks):
        axes.plot(date2num(mark.moments), [line] * len(mark.moments), "|", color=mark.colour, ms=9, mew=2.0)
    axes.set_yticks(range(len(marks)), [f"{m.label} ({len(m.moments)})" for m in marks])
    for label, mark in zip(axes.get_yticklabels(), marks, strict=True):
        label.set_color(mark.colour)
    axes.set_ylim(len(marks) - 0.4, -0.6)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _draw_fall(axes: Axes, fall: Fall) -> None:
    heading(axes, labelled(fall.title, fall.unit))
    time = date2num(fall.moments)
    axes.plot(time, fall.before, "o", color=FAILING, ms=3.6, label="rigid tool")
    axes.plot(time, fall.after, "o", color=HOLDING, ms=3.6, label="with the effects added")
    axes.set_ylim(bottom=0)
    axes.legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))


def _draw_course(axes: Axes, course: Course) -> None:
    heading(axes, labelled(course.title, course.unit))
    time, known = date2num(course.moments), np.isfinite(course.std)
    for sure, face in ((True, INK), (False, "white")):
        part = course.sure == sure
        shown = part & known
        axes.errorbar(time[shown], course.value[shown], course.std[shown], fmt="none", ecolor=FAINT, elinewidth=1.6)
        axes.plot(time[part], course.value[part], "o", color=INK, mfc=face, ms=3.6, mew=0.8)
    if course.levels:
        moments, levels = zip(*course.levels, strict=True)
        axes.plot(date2num(moments), levels, color=FAILING, lw=1.4, zorder=3)
    axes.set_ylim(*_limits(course))


def _limits(course: Course) -> tuple[float, float]:
    """Limits that hold the values, and bars unless they are longer than what the values span."""
    low, high = float(course.value.min()), float(course.value.max())
    span = high - low or 0.1 * abs(high) or 1.0
    bar = np.minimum(np.where(np.isfinite(course.std), course.std, 0.0), span)
    low, high = float((course.value - bar).min()), float((course.value + bar).max())
    return low - 0.08 * span, high + 0.08 * span


def _date_axis(axes: Axes, moments: Sequence[datetime]) -> None:
    first, last = min(moments), max(moments)
    room = ROOM * (last - first) or timedelta(hours=1)
    axes.set_xlim(*date2num([first - room, last + room]))
    locator = AutoDateLocator(minticks=3, maxticks=9)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(
        ConciseDateFormatter(locator, formats=FORMATS, zero_formats=ZERO_FORMATS, show_offset=False)
    )
    axes.set_xlabel(f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}")
