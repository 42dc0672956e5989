"""Picture of a reading: what was mended, channels, clock offset, sampling intervals, directions of gravity."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimation.logs.log_picture import pictured_reading
from estimation.recordings.recording import Recording
from estimation.recordings.reports.reading_curves import ReadingCurves
from estimation.recordings.reports.reading_report import ReadingReport
from modeling.errors import InputError, kind_of
from truewrench.plots.reading.alignment_plot import draw_alignment, draw_chi_square, draw_scan
from truewrench.plots.reading.channel_plot import channel_columns, draw_channels, draw_colour_key, time_limits
from truewrench.plots.reading.gravity_direction_plot import draw_gravity_directions
from truewrench.plots.reading.interval_plot import draw_intervals
from truewrench.plots.reading.step_plot import draw_steps, shown_steps, steps_height
from truewrench.plots.style import INK, NORMAL, WIDTH, PixelLayout

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
