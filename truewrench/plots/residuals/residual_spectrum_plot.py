"""Amplitude spectrum of the residual, excited lines marked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.noise.recording_noise import NoiseSource, sample_step
from estimation.recordings.reports.decimation import extremes
from modeling.number_format import axis_label
from modeling.significance import LEVELS
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.style import FAINT, INK, LEGEND, MEASURED, PanelGrid, label_y_axis, panel_title

Array = NDArray[np.float64]

PIXEL_COLUMNS = 300


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
    labels = channel_labels(sides)
    sheet = PanelGrid(rows=len(labels), columns=len(sides), panel_height=105, top=44)
    figure, panels = sheet.panels(sharex=True, sharey="row")
    for column, side in enumerate(sides):
        lines = residual_spectrum(side)
        panel_title(panels[0, column], side.label, side.colour)
        for row, (name, unit) in enumerate(labels):
            axes = panels[row, column]
            axes.set_xscale("log")
            axes.set_yscale("log")
            _channel(axes, lines, row, side.colour)
            if not column:
                label_y_axis(axes, axis_label(f"{name} amplitude", unit))
        panels[-1, column].set_xlabel("frequency (Hz)")
    for row in range(len(labels)):
        panels[row, 0].set_ylim(*_limits(sides, row))
    figure.legend(*_all_handles(panels[0]), **LEGEND, ncols=4, loc="upper right", borderaxespad=0.2)
    return figure


def _all_handles(panels: Iterable[Axes]) -> tuple[list[Any], list[str]]:
    """Legend entries of all panels, each once."""
    found: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        found = dict(zip(labels, handles, strict=True)) | found
    return list(found.values()), list(found)


def _limits(sides: Sequence[LabelledComparison], channel: int) -> tuple[float, float]:
    """From an eighth of the median amplitude to twice the largest."""
    amplitude = np.concatenate([residual_spectrum(side).amplitude[:, channel] for side in sides])
    middle, top = float(np.median(amplitude)), float(amplitude.max())
    return max(middle / 8, 1e-12), max(top, middle, 1e-11) * 2


def _channel(axes: Axes, lines: ResidualSpectrum, channel: int, colour: str) -> None:
    amplitude = lines.amplitude[:, channel]
    non_excited = ~lines.motion
    label = "non-excited lines" if lines.motion.any() else "amplitude"
    if non_excited.any():
        axes.plot(*_decimated(lines.frequency[non_excited], amplitude[non_excited]), color=FAINT, lw=0.7, label=label)
    if lines.motion.any():
        _excited_lines(axes, lines, channel, colour)
    else:
        axes.plot(*_smoothed(lines.frequency, amplitude), color=colour, lw=1.3, label="RMS over a band")
    if lines.noise is not None:
        shown = np.unique(np.geomspace(1, len(lines.frequency), 200).astype(int)) - 1
        axes.plot(lines.frequency[shown], lines.noise[shown, channel], color=INK, lw=1.0, ls="--", label="noise")


def _excited_lines(axes: Axes, lines: ResidualSpectrum, channel: int, colour: str) -> None:
    frequency, amplitude = lines.frequency[lines.motion], lines.amplitude[lines.motion, channel]
    if lines.noise is None:
        axes.plot(frequency, amplitude, "o", ms=3.2, color=colour, label="excited lines")
        return
    noise = lines.noise[lines.motion, channel]
    significant = amplitude > noise * np.sqrt(np.log(len(amplitude) / LEVELS.spectral_line))
    axes.plot(
        frequency[~significant],
        amplitude[~significant],
        "o",
        ms=1.8,
        color=MEASURED,
        mew=0,
        label="excited lines, within noise",
    )
    axes.vlines(frequency[significant], noise[significant], amplitude[significant], color=colour, lw=1.0)
    axes.plot(
        frequency[significant], amplitude[significant], "o", ms=3.6, color=colour, label="excited lines, above noise"
    )


def _decimated(frequency: Array, amplitude: Array) -> tuple[Array, Array]:
    """The smallest and the largest amplitude in each pixel column of a logarithmic axis."""
    if len(frequency) < 2 * PIXEL_COLUMNS:
        return frequency, amplitude
    column = np.floor(PIXEL_COLUMNS * np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0]))
    return extremes(frequency, amplitude, np.append(np.unique(column, return_index=True)[1], len(column)))


def _smoothed(frequency: Array, amplitude: Array) -> tuple[Array, Array]:
    """RMS amplitude over bands of equal width on a logarithmic axis."""
    edges = np.unique(np.geomspace(1, len(frequency) + 1, 80).astype(int)) - 1
    pairs = list(pairwise(edges))
    centre = np.array([frequency[a:b].mean() for a, b in pairs])
    return centre, np.array([np.sqrt((amplitude[a:b] ** 2).mean()) for a, b in pairs])
