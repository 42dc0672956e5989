"""Residual maps and amplitude spectra of the residual."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from diagnosis.comparison.residual_map import ResidualMap
from estimation.noise.recording_noise import sample_step
from modeling.noise import NoiseSource
from modeling.number_format import axis_label, format_number, format_unit
from modeling.significance import LEVELS
from truewrench.plots.chart import Band, Chart, Level, Line, Mark, Panel, Points, value_limits
from truewrench.plots.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import FAINT, INK, MEASURED, MISFIT_COLOUR
from truewrench.plots.time_series_plot import LabelledComparison, channel_labels

# Amplitude spectrum of the residual, excited lines marked.


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Amplitudes of a residual, in the channel's unit.

    frequency, amplitude  all lines but zero, Hz, (m,) and (m, p)
    motion                mask of the excited lines (m,); none for a single run
    noise                 RMS amplitude of the noise at each line (m, p), None if unknown
    """

    frequency: Array
    amplitude: Array
    motion: NDArray[np.bool_]
    noise: Array | None


def residual_spectrum(side: LabelledComparison) -> ResidualSpectrum:
    """Amplitudes over the whole record if its repeats are continuous, else of the mean over the runs."""
    recording, residual = side.recording, side.comparison.residual
    whole = recording.continuous or recording.repeats == 1
    series = residual if whole else side.residual
    n = len(series)
    single = recording.repeats == 1
    window = np.hanning(n) if single else np.ones(n)
    amplitude = 2 * np.abs(np.fft.rfft((series - series.mean(axis=0)) * window[:, None], axis=0))[1:] / window.sum()
    frequency = np.asarray(np.fft.rfftfreq(n, sample_step(recording))[1:], dtype=np.float64)
    index = np.arange(1, len(frequency) + 1)
    excited = np.zeros(len(index), dtype=bool) if single else index % (recording.repeats if whole else 1) == 0
    averaged = 1 if whole else recording.repeats
    noise = _noise_amplitude(side, frequency, float((window**2).sum() / window.sum() ** 2 / averaged))
    return ResidualSpectrum(frequency, amplitude, excited, noise)


def _noise_amplitude(side: LabelledComparison, frequency: Array, gain: float) -> Array | None:
    """2 sqrt(S gain): the RMS amplitude of noise of the spectrum S per sample."""
    noise = side.comparison.noise
    if noise.spectra:
        return np.stack([2 * np.sqrt(s(frequency) * gain) for s in noise.spectra], axis=1)
    if noise.source is NoiseSource.RIG:
        return np.asarray(np.tile(2 * side.floor * np.sqrt(gain), (len(frequency), 1)))
    return None


def residual_spectrum_figure(sides: Sequence[LabelledComparison]) -> Figure:
    """A row per channel, a column per model: non-excited lines grey, excited lines as points, noise as a curve."""
    return matplotlib_figure(residual_spectrum_chart(sides))


def residual_spectrum_chart(sides: Sequence[LabelledComparison], channel: int | None = None) -> Chart:
    """Amplitude spectra of the residual, a column per model, a row per channel or of one `channel` alone.

    Non-excited lines are grey, excited lines points, noise a curve; models share the scale of a channel, which is
    logarithmic.
    """
    spectra = [residual_spectrum(side) for side in sides]
    labels = channel_labels(sides)
    ends = [(lines.frequency[0], lines.frequency[-1]) for lines in spectra]
    reach = value_limits([np.array(ends)], log=True)
    chosen = range(len(labels)) if channel is None else (channel,)
    rows: list[tuple[Panel, ...]] = []
    for row in chosen:
        name, unit = labels[row]
        limits = _limits(spectra, row)
        panels = tuple(
            Panel(
                marks=tuple(_marks(lines, row, side.colour)),
                title="" if rows else side.label,
                title_colour=side.colour,
                x_label="frequency (Hz)",
                y_label=axis_label(f"{name} amplitude", unit),
                x_limits=reach,
                x_log=True,
                y_log=True,
                y_limits=limits,
            )
            for side, lines in zip(sides, spectra, strict=True)
        )
        rows.append(panels)
    return Chart(
        rows=tuple(rows), row_height=105 if channel is None else 200, main=(0, len(sides) - 1), shared_x=True,
        shared_y=True, between_rows=16,
    )  # fmt: skip


def _limits(spectra: Sequence[ResidualSpectrum], channel: int) -> tuple[float, float]:
    """From an eighth of the median amplitude to twice the largest."""
    amplitude = np.concatenate([spectrum.amplitude[:, channel] for spectrum in spectra])
    middle, top = float(np.median(amplitude)), float(amplitude.max())
    return max(middle / 8, 1e-12), max(top, middle, 1e-11) * 2


def _marks(lines: ResidualSpectrum, channel: int, colour: str) -> Iterator[Mark]:
    amplitude, free = lines.amplitude[:, channel], ~lines.motion
    if free.any():
        label = "non-excited lines" if lines.motion.any() else "amplitude"
        yield Line(x=lines.frequency[free], y=amplitude[free], colour=FAINT, width=0.7, label=label)
    if lines.motion.any():
        yield from _excited_lines(lines, channel, colour)
    else:
        middle, mean = _smoothed(lines.frequency, amplitude)
        yield Line(x=middle, y=mean, colour=colour, width=1.3, label="RMS over a band")
    if lines.noise is not None:
        shown = np.unique(np.geomspace(1, len(lines.frequency), 200).astype(int)) - 1
        noise = lines.noise[shown, channel]
        yield Line(x=lines.frequency[shown], y=noise, colour=INK, width=1.0, dashed=True, label="noise")


def _excited_lines(lines: ResidualSpectrum, channel: int, colour: str) -> Iterator[Mark]:
    """Those above the noise stand on it; without a known noise all are alike."""
    frequency, amplitude = lines.frequency[lines.motion], lines.amplitude[lines.motion, channel]
    if lines.noise is None:
        yield Points(x=frequency, y=amplitude, colour=colour, size=3.2, label="excited lines")
        return
    noise = lines.noise[lines.motion, channel]
    above = amplitude > noise * np.sqrt(np.log(len(amplitude) / LEVELS.spectral_line))
    within = Points(x=frequency[~above], y=amplitude[~above], colour=MEASURED, size=1.8,
                    label="excited lines, within noise")  # fmt: skip
    yield within
    x, y = frequency[above], amplitude[above]
    yield Points(x=x, y=y, low=noise[above], high=y, colour=colour, size=3.6, label="excited lines, above noise")


def _smoothed(frequency: Array, amplitude: Array) -> tuple[Array, Array]:
    """RMS amplitude over bands of equal width on a logarithmic axis."""
    edges = np.unique(np.geomspace(1, len(frequency) + 1, 80).astype(int)) - 1
    pairs = list(pairwise(edges))
    centre = np.array([frequency[a:b].mean() for a, b in pairs])
    return centre, np.array([np.sqrt((amplitude[a:b] ** 2).mean()) for a, b in pairs])


# Residual maps of one channel.


ROW_HEIGHT = 112


def residual_map_figure(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Figure:
    """Residual maps of one channel: a row per model (label, maps), a column per variable."""
    return matplotlib_figure(residual_map_chart(rows))


def residual_map_chart(rows: Sequence[tuple[str, Sequence[ResidualMap]]]) -> Chart:
    """Residual maps of one channel: a row per model (label, maps), a column per variable, each row in its own scale.

    Cells that are significant and above tolerance are full and coloured, the others hollow and grey; bars are 95 %
    intervals; the band is the tolerance.
    """
    panels = [
        tuple(_panel("" if n else label, m, _map_limits(maps)) for n, m in enumerate(maps)) for label, maps in rows
    ]
    return Chart(
        rows=tuple(panels), row_height=ROW_HEIGHT, main=(len(rows) - 1, 0), shared_x=True, shared_y=True,
        left=76, between_rows=30,
    )  # fmt: skip


def _panel(label: str, shown: ResidualMap, limits: tuple[float, float]) -> Panel:
    return Panel(
        marks=(_tolerance(shown), Level(y=0), *_cells(shown)),
        title=label,
        x_label=axis_label(shown.variable, shown.variable_unit),
        y_label=axis_label(f"residual of {shown.channel}", shown.channel_unit),
        y_limits=limits,
    )


def _tolerance(shown: ResidualMap) -> Band:
    """Its size is in the legend: beside a large residual the band is as thin as a line."""
    size = f"tolerance ± {format_number(shown.tolerance, 2)} {format_unit(shown.channel_unit)}"
    return Band(low=-shown.tolerance, high=shown.tolerance, label=size)


def _cells(shown: ResidualMap) -> tuple[Mark, ...]:
    full = shown.practically_significant
    kinds = (
        (~full, MEASURED, "mean residual with 95 % interval, negligible or within noise"),
        (full, MISFIT_COLOUR, "significant and above tolerance"),
    )
    cells = tuple(
        Points(
            x=shown.centre[inside], y=shown.mean[inside], low=shown.low[inside], high=shown.high[inside],
            interval="95 %", colour=colour, size=3.0 if colour == MEASURED else 3.8, hollow=colour == MEASURED,
            label=label,
        )
        for inside, colour, label in kinds
    )  # fmt: skip
    return (Line(x=shown.centre, y=shown.mean, colour=MEASURED, width=0.6, opacity=0.6), *cells)


def _map_limits(maps: Sequence[ResidualMap]) -> tuple[float, float]:
    """Limits that contain every mean, and every interval up to thrice what most of them need.

    Most: the 95 % quantile of the intervals, at most twice the largest mean.
    """
    mean = max(float(np.abs(m.mean).max()) for m in maps)
    bars = np.concatenate([np.maximum(np.abs(m.low), np.abs(m.high)) for m in maps])
    most = max(mean, min(float(np.quantile(bars, 0.95)), 2 * mean), 1.3 * maps[0].tolerance)
    limit = 1.1 * max(most, min(float(bars.max()), 3 * most))
    return -limit, limit
