"""Measured and predicted channel, and residual with noise band."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.residual_map import residual_maps
from estimation.noise.recording_noise import sample_step
from estimation.recordings.recording import Recording
from modeling.noise import NoiseSource
from modeling.number_format import axis_label
from truewrench.plots.chart import Band, Chart, Level, Line, Mark, Panel, Points, Span, decimated, value_limits
from truewrench.plots.matplotlib_chart import LINE_COLUMNS, draw_panel, fit_grid
from truewrench.plots.style import HELD_OUT, MEASURED, MUTED, NOISE, QUIET_NOISE, PanelGrid, panel_title

# A model's comparison with a recording, with label and colour: one column of panels.


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledComparison:
    """Comparison of one model with one recording, with label and colour."""

    label: str
    colour: str
    comparison: Comparison

    @property
    def recording(self) -> Recording:
        """The recording compared."""
        return self.comparison.recording

    @property
    def floor(self) -> Array:
        """Noise floor per channel, (p,)."""
        return np.array([self.comparison.noise_floor[c] for c in self.recording.channels])

    @property
    def noise_label(self) -> str:
        """Source of the noise floor, for legends."""
        from_residual = self.comparison.noise.source is NoiseSource.RESIDUAL
        return "noise, estimated from the residual" if from_residual else "noise of one sample"

    @property
    def measured(self) -> Array:
        """Mean over the repeats of the measured wrench, (samples of one repeat, p)."""
        return self.recording.averaged(self.recording.wrench)[: self.recording.samples_per_repeat]

    @property
    def residual(self) -> Array:
        """Mean over the repeats of measured minus predicted, (samples of one repeat, p)."""
        return self.recording.averaged(self.comparison.residual)[: self.recording.samples_per_repeat]

    @property
    def predicted(self) -> Array:
        """Mean over the repeats of the prediction, (samples of one repeat, p)."""
        return self.measured - self.residual

    @property
    def instants(self) -> Array:
        """Time in one repeat (s), or the number of each pose from 1."""
        count = np.arange(self.recording.samples_per_repeat, dtype=float)
        return count + 1 if self.recording.at_rest else count * sample_step(self.recording)


def channel_labels(sides: Sequence[LabelledComparison]) -> list[tuple[str, str]]:
    """Name and unit of each channel."""
    return list(sides[0].comparison.space.channel_units.items())


# Non-periodic part of the residual over the record (drift, transients).


INTERVALS = 8
"""Of one repeat over which the non-periodic residual is averaged."""


def nonperiodic_residual_figure(sides: Sequence[LabelledComparison]) -> Figure:
    """Non-periodic residual of every channel over the record, averaged over intervals; band ± 2 std."""
    labels = channel_labels(sides)
    grid = PanelGrid(rows=len(labels), columns=len(sides), panel_height=80)
    figure, panels = grid.panels(sharex=True, sharey="row")
    for column, side in enumerate(sides):
        (time, means), std = nonperiodic_residual(side), std_of_interval_means(side)
        panel_title(panels[0, column], side.label, side.colour)
        for row, (name, unit) in enumerate(labels):
            axes = panels[row, column]
            for start, end in side.comparison.noise.events:
                axes.axvspan(start, end, color=HELD_OUT, alpha=0.25, lw=0, zorder=0.1)
            draw_nonperiodic_residual(axes, time, means[:, row], float(std[row]), side.colour)
            if not column:
                axes.set_ylabel(axis_label(name, unit))
        panels[-1, column].set_xlabel("time in the record (s)")
    fit_grid(figure, panels, grid)
    return figure


def draw_nonperiodic_residual(axes: Axes, time: Array, means: Array, std: float, colour: str) -> None:
    """Non-periodic residual of a channel in steps, with the band of ± 2 std."""
    axes.axhspan(-2 * std, 2 * std, color=NOISE, lw=0, zorder=0)
    axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)
    x, y = decimated(Line(x=time, y=means, colour=colour), LINE_COLUMNS, log=False)
    axes.plot(x, y, color=colour, lw=1.2, drawstyle="steps-mid")
    axes.margins(x=0.01)


def nonperiodic_residual(side: LabelledComparison) -> tuple[Array, Array]:
    """Middle of each interval (s), and the mean there of the residual less its periodic part, (intervals, p)."""
    recording = side.recording
    residual = side.comparison.residual
    blocks = (residual - recording.averaged(residual)).reshape(recording.repeats, recording.samples_per_repeat, -1)
    parts = min(INTERVALS, recording.samples_per_repeat)
    means = [interval.mean(axis=1) for interval in np.array_split(blocks, parts, axis=1)]
    series = np.stack(means, axis=1).reshape(recording.repeats * parts, -1)
    span = recording.samples * sample_step(recording) / len(series)
    return np.asarray((np.arange(len(series)) + 0.5) * span), np.asarray(series)


def std_of_interval_means(side: LabelledComparison) -> Array:
    """Std of the mean over one interval from the noise spectrum, less the part in the mean over repeats; (p,).

    The mean over L of N samples weights |X_k|² = N S_k with |B_k|² / N², B the transform of a box of height 1/L.
    """
    recording = side.recording
    n, repeats = recording.samples, recording.repeats
    box = np.zeros(n)
    length = max(1, recording.samples_per_repeat // INTERVALS)
    box[:length] = 1 / length
    gain = np.abs(np.fft.rfft(box)[1:]) ** 2
    frequency = np.asarray(np.fft.rfftfreq(n, sample_step(recording))[1:], dtype=np.float64)
    levels = np.stack([s(frequency) for s in side.comparison.noise.spectra], axis=1)
    return np.asarray(np.sqrt(2 * (gain[:, None] * levels).sum(axis=0) / n * (1 - 1 / repeats)))


def running_mean(y: Array, length: int) -> Array:
    """The mean over `length` samples about each sample, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(y)])
    index = np.arange(len(y))
    low, high = np.maximum(index - length // 2, 0), np.minimum(index + (length + 1) // 2, len(y))
    return np.asarray((total[high] - total[low]) / (high - low))


HEIGHT = 100
"""Mean height of the two panels."""
OVERLAID_HEIGHT = 145
"""Of each of two panels as wide as the page."""
TREND_PARTS = 80
"""Intervals of a repeat over which the trend is averaged."""


def time_series_chart(sides: Sequence[LabelledComparison], channel: int) -> Chart:
    """Measured and predicted above the residual of a channel, a column per model; each residual in its own scale."""
    above = tuple(measured_panel(side, channel, titled=True) for side in sides)
    below = tuple(residual_panel(side, channel, residual_limits([side], channel)) for side in sides)
    return Chart(
        rows=(above, below), heights=(1, 1.25), row_height=HEIGHT, main=(1, len(sides) - 1), shared_x=True,
        between_rows=16,
    )  # fmt: skip


def overlaid_chart(sides: Sequence[LabelledComparison], channel: int) -> Chart:
    """The same in two large panels, all models in one scale: to zoom, and to read one model against another."""
    above = [measured_panel(side, channel) for side in sides]
    limits = residual_limits(sides, channel)
    below = [residual_panel(side, channel, limits) for side in sides]
    shown = {side.label: panel.marks[1:] for side, panel in zip(sides, above, strict=True)}
    noise = len(noise_marks(sides[0], channel))
    residuals = {side.label: panel.marks[noise:] for side, panel in zip(sides, below, strict=True)}
    measured = [side.predicted[:, channel] for side in sides]
    return Chart(
        rows=(
            (replace(above[0], marks=(above[0].marks[0], *_of_models(shown)),
                     y_limits=value_limits([sides[0].measured[:, channel], *measured])),),
            (replace(below[0], marks=(*below[0].marks[:noise], *_of_models(residuals))),),
        ),
        row_height=OVERLAID_HEIGHT, shared_x=True,
    )  # fmt: skip


def _of_models(marks: Mapping[str, Sequence[Mark]]) -> Iterator[Mark]:
    """Marks of each model by its label, which their labels name where there are several."""
    for model, drawn in marks.items():
        for mark in drawn:
            if len(marks) > 1 and isinstance(mark, Line | Points):
                yield replace(mark, label=f"{mark.label or 'residual'}, {model}")
            else:
                yield mark


def measured_chart(sides: Sequence[LabelledComparison], channel: int) -> Chart:
    """Measured and predicted of a channel, a column per model, in one scale."""
    panels = tuple(measured_panel(side, channel, titled=True) for side in sides)
    return Chart(rows=(panels,), row_height=2 * HEIGHT, main=(0, len(sides) - 1), shared_y=True)


def measured_panel(side: LabelledComparison, channel: int, *, titled: bool = False) -> Panel:
    """Measured and predicted of a channel over time, of static poses by their number."""
    measured, predicted = side.measured[:, channel], side.predicted[:, channel]
    return Panel(
        marks=(_points if side.recording.at_rest else _lines)(side, measured, predicted),
        title=side.label if titled else "",
        title_colour=side.colour,
        x_label=instants_label(side),
        y_label=axis_label(*channel_labels([side])[channel]),
        x_limits=time_limits(side),
        y_limits=value_limits([measured, predicted]),
    )


def residual_panel(side: LabelledComparison, channel: int, limits: tuple[float, float]) -> Panel:
    """Residual with its noise band over time, samples (pale) and trend; of static poses as points with stems."""
    name, unit = channel_labels([side])[channel]
    return Panel(
        marks=(*noise_marks(side, channel), *_residual_marks(side, side.residual[:, channel])),
        x_label=instants_label(side),
        y_label=axis_label(f"residual of {name}", unit),
        x_limits=time_limits(side),
        y_limits=limits,
    )


def residual_limits(sides: Sequence[LabelledComparison], channel: int) -> tuple[float, float]:
    """Limits that contain the residual of every model, and the noise floor."""
    largest = max(float(np.abs(side.residual[:, channel]).max()) for side in sides)
    limit = 1.12 * max(largest, 1.1 * float(sides[0].floor[channel]))
    return (-limit, limit) if limit > 0 else (-1.0, 1.0)


def noise_marks(side: LabelledComparison, channel: int) -> tuple[Mark, ...]:
    """Bands: ± noise of one sample, and within it ± noise of the mean over the repeats."""
    floor, repeats = float(side.floor[channel]), side.recording.repeats
    sample = Band(low=-floor, high=floor, label=f"± {side.noise_label}")
    if repeats == 1:
        return sample, Level(y=0)
    quiet = floor / np.sqrt(repeats)
    mean = Band(low=-quiet, high=quiet, colour=QUIET_NOISE, label=f"± noise of the mean of {repeats}")
    return sample, mean, Level(y=0)


def draw_residual(axes: Axes, side: LabelledComparison, channel: int) -> None:
    """The residual on axes that are labelled elsewhere."""
    draw_panel(axes, replace(residual_panel(side, channel, residual_limits([side], channel)), x_label="", y_label=""))


def _residual_marks(side: LabelledComparison, residual: Array) -> tuple[Mark, ...]:
    if side.recording.at_rest:
        low, high = np.minimum(residual, 0), np.maximum(residual, 0)
        return (Points(x=side.instants, y=residual, colour=side.colour, size=3.2, low=low, high=high),)
    trend = running_mean(residual, max(1, len(residual) // TREND_PARTS))
    whose = "residual" if side.recording.repeats == 1 else "residual, mean over the repeats"
    samples = Line(x=side.instants, y=residual, colour=side.colour, width=0.5, opacity=0.45, label=whose)
    smooth = Line(x=side.instants, y=trend, colour=side.colour, width=1.3, label="its moving mean")
    return (samples, smooth, *_events(side))


def _events(side: LabelledComparison) -> tuple[Mark, ...]:
    events = side.comparison.noise.events if side.recording.repeats == 1 else ()
    return tuple(Span(start=a, end=b, colour=HELD_OUT, opacity=0.18, label="transient event") for a, b in events)


def time_limits(side: LabelledComparison) -> tuple[float, float]:
    """One repeat with a margin at both ends."""
    first, last = float(side.instants[0]), float(side.instants[-1])
    margin = 0.5 if side.recording.at_rest else 0.012 * (last - first)
    return first - margin, last + margin


def _lines(side: LabelledComparison, measured: Array, predicted: Array) -> tuple[Mark, ...]:
    at = side.instants
    return (
        Line(x=at, y=measured, colour=MEASURED, width=4.5, opacity=0.45, label="measured"),
        Line(x=at, y=predicted, colour=side.colour, width=1.2, label="predicted"),
    )


def _points(side: LabelledComparison, measured: Array, predicted: Array) -> tuple[Mark, ...]:
    at = side.instants
    return (
        Points(x=at, y=measured, colour=MEASURED, size=5.5, label="measured"),
        Points(x=at, y=predicted, colour=side.colour, size=9, symbol="_", label="predicted"),
    )


def instants_label(side: LabelledComparison) -> str:
    """What is across: time in a repeat or run, or the number of a pose."""
    if side.recording.at_rest:
        return "pose, in the order of recording"
    return "time in one repeat (s)" if side.recording.repeats > 1 else "time (s)"


# Residual of the channel with the largest error-to-noise ratio, before and after.


WORST_CHANNEL_HEIGHT = 135
MIN_SIGNAL_TO_NOISE = 2.0
"""Error-to-noise ratio above which a channel is chosen by it."""


def worst_channel_figure(sides: Sequence[LabelledComparison], worst: tuple[bool, int]) -> Figure:
    """Residual of the `worst_channel`, a column per model, in one scale."""
    grid = PanelGrid(rows=1, columns=len(sides), panel_height=WORST_CHANNEL_HEIGHT)
    figure, panels = grid.panels(sharex=True, sharey=True)
    nonperiodic, channel = worst
    for axes, side in zip(panels[0], sides, strict=True):
        panel_title(axes, side.label, side.colour)
        if nonperiodic:
            time, means = nonperiodic_residual(side)
            draw_nonperiodic_residual(
                axes, time, means[:, channel], float(std_of_interval_means(side)[channel]), side.colour
            )
        else:
            draw_residual(axes, side, channel)
            axes.set_ylim(*residual_limits(sides, channel))
        axes.set_xlabel("pose" if side.recording.at_rest else "time (s)")
    name, unit = channel_labels(sides)[channel]
    panels[0, 0].set_ylabel(axis_label(f"residual of {name}", unit))
    fit_grid(figure, panels, grid)
    return figure


def worst_channel(side: LabelledComparison) -> tuple[bool, int]:
    """Whether the non-periodic residual / noise exceeds the periodic one, and the channel where the larger peaks."""
    repeats = side.recording.repeats
    floor = np.maximum(side.floor, 1e-300)
    periodic_ratio = np.sqrt((side.residual**2).mean(axis=0)) / floor * np.sqrt(repeats)
    if repeats == 1 or side.recording.at_rest or not side.recording.continuous:
        from_residual = (
            side.comparison.noise.source is NoiseSource.RESIDUAL and periodic_ratio.max() < MIN_SIGNAL_TO_NOISE
        )
        return False, _most_explained(side) if from_residual else int(periodic_ratio.argmax())
    _, means = nonperiodic_residual(side)
    nonperiodic_ratio = np.sqrt((means**2).mean(axis=0)) / np.maximum(std_of_interval_means(side), 1e-300)
    nonperiodic = bool(nonperiodic_ratio.max() > max(periodic_ratio.max(), MIN_SIGNAL_TO_NOISE))
    return nonperiodic, int((nonperiodic_ratio if nonperiodic else periodic_ratio).argmax())


def _most_explained(side: LabelledComparison) -> int:
    """Channel of the residual map that explains most, for noise estimated from the residual itself."""
    channels = side.recording.channels
    best = residual_maps(side.comparison, dict.fromkeys(channels, 0.0))[0]
    return channels.index(best.channel)
