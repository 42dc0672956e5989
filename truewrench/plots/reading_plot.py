"""Picture of a reading: what was mended, channels, clock offset, sampling intervals, directions of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from numpy.typing import NDArray

from estimation.reading.log_import import pictured_reading
from estimation.recordings.reading_report import (
    ClockReading,
    OffsetReading,
    ReadingCurves,
    ReadingReport,
    ReadingStep,
    Span,
    StepKind,
)
from estimation.recordings.recording import Recording
from modeling.errors import InputError, kind_of
from modeling.number_format import axis_label
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS
from truewrench.plots.style import (
    ADEQUATE_COLOUR,
    FAINT,
    HELD_OUT,
    INK,
    LEGEND,
    MEASURED,
    MISFIT_COLOUR,
    MUTED,
    NOISE,
    NORMAL,
    QUIET_NOISE,
    SMALL,
    WIDTH,
    PixelLayout,
    panel_title,
)

# Wrench and motion before and after alignment of their clocks, and the scan that gave the offset.


INTERVAL_COLOUR = "#CFE3F1"


def draw_alignment(before: Axes, after: Axes, offset: OffsetReading, report: ReadingReport) -> None:
    """One channel and what weight and inertia force explain of it, by the stamps as read, and by the offset."""
    curves = offset.curves
    assert curves is not None
    channel = SPATIAL_CHANNELS[curves.channel]
    panel_title(before, "wrench and motion by their stamps, as read")
    moved = f"with the offset of {offset.offset * 1e3:.3g} ms"
    panel_title(after, f"{moved} taken out" if offset.applied else f"{moved}, which is not applied")
    for axes, explained in ((before, curves.as_stamped), (after, curves.aligned)):
        time = curves.instants - curves.instants[0]
        axes.plot(time, curves.measured, color=MEASURED, lw=2.2, alpha=0.75, label="measured")
        axes.plot(time, explained, color=ADEQUATE_COLOUR, lw=1.0, label="explained by the motion")
        axes.set_ylabel(axis_label(channel, "N"))
        axes.set_xlabel("time in the fastest part of the recording (s)")
        axes.margins(x=0.01)
    before.legend(**LEGEND, loc="best")


def draw_scan(axes: Axes, offset: OffsetReading) -> None:
    """Share of the wrench's variance that the motion explains, over the offset."""
    curves = offset.curves
    assert curves is not None
    panel_title(axes, "variance of the wrench that the motion explains")
    axes.plot(curves.offsets * 1e3, curves.share, color=ADEQUATE_COLOUR, lw=1.0)
    axes.axvline(offset.offset * 1e3, color=MISFIT_COLOUR, lw=0.9)
    for other in offset.alternatives:
        axes.axvline(other * 1e3, color=MUTED, lw=0.7, ls=":")
    axes.set(xlabel="clock offset: wrench's stamp minus motion's (ms)", ylabel="share", ylim=(None, 1.02))
    axes.margins(x=0.01)


def draw_chi_square(axes: Axes, offset: OffsetReading) -> None:
    """Chi-square of the whole model near the estimate, with the 95 % interval."""
    curves = offset.curves
    assert curves is not None
    low, high = (bound * 1e3 for bound in offset.interval)
    text = f"offset {offset.offset * 1e3:.2f} ms, 95 % interval {low:.2f} to {high:.2f} ms"
    panel_title(axes, text)
    axes.axvspan(low, high, color=INTERVAL_COLOUR, lw=0, zorder=0)
    axes.plot(curves.near * 1e3, curves.chi_square, color=ADEQUATE_COLOUR, lw=1.0, marker="o", ms=2.5)
    axes.axvline(offset.offset * 1e3, color=MISFIT_COLOUR, lw=0.9)
    axes.set(xlabel="clock offset (ms)", ylabel="chi-square, rise")
    axes.yaxis.label.set_fontsize(SMALL)
    axes.ticklabel_format(axis="x", useOffset=False)


# Steps of a reading over time: a row each, with its sentence and when it happened.


LINE, BAR = 13.0, 14.0
"""CSS pixels of a line of a step's sentence, and of its instants below it."""
MOST_STEPS = 14
CHARACTERS = 165
"""Of a line."""
COLOURS: Mapping[StepKind, str] = {StepKind.MENDED: HELD_OUT, StepKind.SUSPICIOUS: MISFIT_COLOUR}
"""Of what was mended and of what is suspicious."""


def shown_steps(steps: Sequence[ReadingStep]) -> list[ReadingStep]:
    """Those that mended something or are suspicious; of very many the first."""
    return [step for step in steps if step.kind in COLOURS][:MOST_STEPS]


def steps_height(steps: Sequence[ReadingStep]) -> float:
    """Height of their panel in CSS pixels."""
    return max(sum(map(_height, steps)), LINE + BAR)


def draw_steps(axes: Axes, steps: Sequence[ReadingStep], limits: Span, *, timed: bool) -> None:
    """A row for each step, from top to bottom: its sentence, and a bar for each interval in which it happened."""
    axes.set(xlim=limits, ylim=(steps_height(steps), 0), yticks=[])
    axes.spines["left"].set_visible(False)
    if any(step.at for step in steps):
        axes.set_xlabel("time (s)" if timed else "pose, in the order of recording")
    else:
        axes.set_xticks([])
        axes.spines["bottom"].set_visible(False)
    panel_title(axes, "what was mended, and what is suspicious")
    if not steps:
        text = "nothing was mended, and nothing is suspicious"
        axes.text(0.0, LINE, text, transform=axes.get_yaxis_transform(), fontsize=SMALL, color=MUTED)
    top = 0.0
    for step in steps:
        _draw_step(axes, top, step)
        top += _height(step)


def _draw_step(axes: Axes, top: float, step: ReadingStep) -> None:
    """A step whose row begins at `top`, CSS pixels."""
    colour, lines, place = COLOURS[step.kind], _lines(step), axes.get_yaxis_transform()
    axes.plot([0.0], [top + LINE - 3], "s", ms=4, color=colour, transform=place, clip_on=False)
    for number, line in enumerate(lines):
        height = top + LINE * number + LINE - 3
        axes.text(0.008, height, line, transform=place, fontsize=SMALL, color=INK, va="center")
    if step.at:
        below = top + LINE * len(lines) + BAR / 2
        axes.hlines(below, *axes.get_xlim(), color=NOISE, lw=1.0, zorder=0)
        bars = [(start, end - start) for start, end in step.at]
        axes.broken_barh(bars, (below - 4, 8), facecolor=colour, edgecolor=colour, lw=1.2)


def _lines(step: ReadingStep) -> list[str]:
    return wrap(f"{step.kind.value}: {step}", CHARACTERS)


def _height(step: ReadingStep) -> float:
    return LINE * len(_lines(step)) + BAR


# Channels of a recording over time, with what was mended, what is suspicious, and the cuts between repeats.


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


# Directions that gravity took in the sensor's axes: on the sphere seen from both sides, in the plane on the circle.


Array = NDArray[np.float64]
FEW = 100
"""Directions that are drawn larger."""


def draw_gravity_directions(views: Sequence[Axes], gravity: Array) -> None:
    """Unit vectors (k, 3) on two views of the sphere, or (k, 2) on one circle."""
    spread = np.linalg.svd(gravity - gravity.mean(axis=0), compute_uv=False) / np.sqrt(len(gravity))
    if gravity.shape[1] == 2:
        _draw_view(views[0], gravity, np.ones(len(gravity), dtype=bool), 1.0)
        panel_title(views[0], "gravity in the sensor")
    else:
        for axes, side in zip(views, (1.0, -1.0), strict=True):
            _draw_view(axes, gravity, side * gravity[:, 2] >= 0, side)
            panel_title(axes, f"gravity, seen from {'+' if side > 0 else '-'}z")
    text = "std of its directions: " + ", ".join(f"{value:.2f}" for value in spread) + " g"
    views[0].text(0.0, -0.25, text, transform=views[0].transAxes, fontsize=SMALL, color=INK, va="top")


def _draw_view(axes: Axes, gravity: Array, near: NDArray[np.bool_], side: float) -> None:
    """The near half in colour, the far half pale; seen from -z, x runs to the left."""
    axes.add_patch(Circle((0, 0), 1, facecolor="none", edgecolor=FAINT, lw=0.9))
    axes.axhline(0, color=FAINT, lw=0.6, zorder=0)
    axes.axvline(0, color=FAINT, lw=0.6, zorder=0)
    axes.plot(*gravity[~near, :2].T, ".", color=MEASURED, ms=2.0, alpha=0.35)
    size = 3.2 if len(gravity) > FEW else 7.0
    axes.plot(*gravity[near, :2].T, ".", color=ADEQUATE_COLOUR, ms=size, alpha=0.8)
    axes.set(xlim=(-1.08 * side, 1.08 * side), ylim=(-1.08, 1.08), aspect="equal")
    axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], xlabel="along the sensor's x (g)", ylabel="along y (g)")


# Histogram of a clock's sampling intervals.


LONGEST_CLOCK_NAME = 30
SMALLEST_JITTER = 1e-6
"""Seconds; less is rounding of the stamps."""


def draw_intervals(axes: Axes, clock: ClockReading) -> None:
    """Intervals between neighbouring stamps, with how many are zero, negative or too long for the axis."""
    panel_title(axes, "sampling intervals")
    intervals = clock.intervals
    if intervals is None:
        return
    scale, unit = (1e3, "ms") if intervals.edges[-1] < 10 else (1.0, "s")
    axes.stairs(
        np.maximum(intervals.counts, 0.5), intervals.edges * scale, color=ADEQUATE_COLOUR, fill=True, baseline=0.5
    )
    axes.set(xlabel=f"interval between stamps ({unit})", ylabel="samples", yscale="log", ylim=(0.5, None))
    axes.set_ylim(0.5, 6 * float(intervals.counts.max(initial=1)))  # leaves room for the text
    axes.set_xlim(0, float(intervals.edges[-1]) * scale)
    jitter = f"jitter {clock.jitter * 1e3:.2g} ms" if clock.jitter > SMALLEST_JITTER else "no jitter"
    lines = [_shortened_clock_name(clock.where), f"{clock.rate:.6g} Hz, {jitter}"]
    lines += [f"{intervals.longer} longer than {intervals.edges[-1] * scale:.3g} {unit}"] if intervals.longer else []
    lines += [f"{intervals.not_increasing} zero or negative"] if intervals.not_increasing else []
    place = {"transform": axes.transAxes, "ha": "right", "va": "top"}
    axes.text(0.99, 0.97, "\n".join(lines), fontsize=SMALL, color=INK, **place)  # type: ignore[arg-type]


def _shortened_clock_name(name: str) -> str:
    return name if len(name) <= LONGEST_CLOCK_NAME else f"..{name[-LONGEST_CLOCK_NAME + 2 :]}"


LEFT, RIGHT, GUTTER = 74.0, 14.0, 84.0
"""CSS pixels: margins, and the space between two columns of panels, which holds labels."""
INSIDE = WIDTH - LEFT - RIGHT
HALF = (INSIDE - GUTTER) / 2
TITLE, HEAD, BOTTOM, AXIS = 58.0, 34.0, 24.0, 50.0
"""Of the page's title, of a section's first panels, below the last, and of an axis with its label."""
CHANNEL, BETWEEN = 56.0, 10.0
LABEL = 50.0
"""Distance of a vertical axis from its label."""
ALIGNMENT, LAST = 134.0, 190.0
MOST_CLOCKS, MOST_NAMES = 2, 3


def plot_reading(reading: Recording | ReadingReport) -> Figure:
    """Picture of a recording, and of how logs became it.

    Panels: every step that mended something or is suspicious, over time; every channel with what was mended marked, and
    the cuts between repeats; wrench and motion by their stamps and by the clock offset, with the offset's scan and 95 %
    interval; a histogram of the sampling intervals; the directions of gravity in the sensor.

    Parameters
    ----------
    reading : Recording or ReadingReport
        A recording, or the `reading` of one that `tw.read` made of logs. Of one that was read as it stands, nothing was
        mended: channels over time, what is suspicious, the cuts between repeats, and the directions of gravity.

    Returns
    -------
    matplotlib.figure.Figure
        Time in s from the recording's first sample, channels in SI units; gravity in the sensor's axes, in units of g,
        with the world's z (in the plane y) up. `figure.savefig(path)` writes it.

    Raises
    ------
    InputError
        For what is no recording, and a report without curves.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"), period=5.0)
    >>> tw.plot_reading(recording).savefig("reading.png")
    >>> recording.reading.curves.cuts
    (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0)
    """
    report = pictured_reading(reading) if isinstance(reading, Recording) else reading
    given: object = report  # whatever the caller's types say
    if not isinstance(given, ReadingReport) or given.curves is None:
        what = f"{kind_of(given)} {'has no curves' if isinstance(given, ReadingReport) else 'is no recording'}"
        raise InputError(what=what, where="plot_reading", remedy="give a recording: tw.plot_reading(tw.read(path))")
    return _Page(given, given.curves).drawn()


class _Page:
    """The page from top to bottom; `top` is where the next section begins, in CSS pixels."""

    def __init__(self, report: ReadingReport, curves: ReadingCurves) -> None:
        self.report, self.curves = report, curves
        self.steps = shown_steps(report.steps)
        self.columns = channel_columns(report, curves)
        self.offset = None if report.offset is None or report.offset.curves is None else report.offset
        self.page = PixelLayout.of(self._height())

    def drawn(self) -> Figure:
        self._title()
        top = self._channels(self._steps(TITLE))
        self._last_row(self._alignment(top))
        for axes in self.page.figure.axes:
            width = axes.get_position().width * WIDTH
            axes.yaxis.set_label_coords(-LABEL / width, 0.5)
        return self.page.figure

    def _height(self) -> float:
        alignment = 0.0 if self.offset is None else HEAD + 2 * (ALIGNMENT + AXIS)
        return TITLE + self._steps_height() + HEAD + self._channels_height() + alignment + HEAD + LAST + AXIS + BOTTOM

    def _steps_height(self) -> float:
        return steps_height(self.steps) + HEAD + (AXIS if any(step.at for step in self.steps) else 0)

    def _channels_height(self) -> float:
        return (CHANNEL + BETWEEN) * max(map(len, self.columns)) - BETWEEN + AXIS

    def _title(self) -> None:
        names = list(dict.fromkeys(used.source for used in self.report.used))
        text = f"{', '.join(names[:MOST_NAMES])}{', ...' if len(names) > MOST_NAMES else ''}: {self.report.size}"
        place = (LEFT / WIDTH, 1 - 18 / self.page.height)
        self.page.figure.text(*place, text, fontsize=NORMAL + 2.5, fontweight="bold", color=INK, va="center")

    def _steps(self, top: float) -> float:
        axes = self.page.panel(LEFT, top, INSIDE, steps_height(self.steps))
        draw_steps(axes, self.steps, time_limits(self.report), timed=self.curves.time is not None)
        return top + self._steps_height()

    def _channels(self, top: float) -> float:
        for place, names in enumerate(self.columns):
            left = LEFT + place * (HALF + GUTTER)
            panels = [self.page.panel(left, top + i * (CHANNEL + BETWEEN), HALF, CHANNEL) for i in range(len(names))]
            draw_channels(panels, names, self.report, self.curves)
        draw_colour_key(self.page.figure, self.report, (LEFT / WIDTH, 1 - (top - 8) / self.page.height))
        return top + self._channels_height()

    def _alignment(self, top: float) -> float:
        if self.offset is None or self.offset.curves is None:
            return top
        top += HEAD
        before, after = (self.page.panel(LEFT, top + i * (ALIGNMENT + AXIS), HALF, ALIGNMENT - 26) for i in (0, 1))
        scan, near = (
            self.page.panel(LEFT + HALF + GUTTER, top + i * (ALIGNMENT + AXIS), HALF, ALIGNMENT - 26) for i in (0, 1)
        )
        draw_alignment(before, after, self.offset, self.report)
        draw_scan(scan, self.offset)
        draw_chi_square(near, self.offset)
        return top + 2 * (ALIGNMENT + AXIS)

    def _last_row(self, top: float) -> None:
        top += HEAD
        clocks = self.report.clocks[:MOST_CLOCKS]
        width = (HALF - GUTTER * (len(clocks) - 1)) / max(len(clocks), 1)
        for i, clock in enumerate(clocks):
            draw_intervals(self.page.panel(LEFT + i * (width + GUTTER), top, width, LAST), clock)
        if self.curves.gravity is not None:
            draw_gravity_directions(self._views(top), self.curves.gravity)

    def _views(self, top: float) -> list[Axes]:
        assert self.curves.gravity is not None
        views = self.curves.gravity.shape[1] - 1
        left = LEFT + HALF + GUTTER if self.report.clocks else LEFT
        return [self.page.panel(left + i * (LAST + GUTTER - 20), top, LAST, LAST) for i in range(views)]
