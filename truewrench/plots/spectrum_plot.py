"""Spectrum plot: the amplitude of what is left at each frequency, with the lines of the motion marked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.noise import NoiseSource, step_of
from truewrench.plots.number import labelled
from truewrench.plots.side import Side, channel_labels
from truewrench.plots.style import FAINT, INK, LEGEND, MEASURED, Sheet, heading, name_y

Array = NDArray[np.float64]

FALSE_ALARM = 0.01
"""Chance that noise alone raises any of the motion's lines above the mark."""
BINS = 300


@dataclass(frozen=True, eq=False)
class Lines:
    """Amplitudes of a residual, in the channel's unit.

    frequency, amplitude  all lines but zero, Hz, (m,) and (m, p)
    motion                which of them the motion has (m,); none for a single run
    noise                 RMS amplitude that the noise has at each line (m, p), None where it is not known
    """

    frequency: Array
    amplitude: Array
    motion: NDArray[np.bool_]
    noise: Array | None


def lines_of(side: Side) -> Lines:
    """Amplitudes over the whole record when its repeats follow one another, else over the mean of the runs."""
    recording, residual = side.recording, side.comparison.residual
    whole = recording.continuous or recording.repeats == 1
    series = residual if whole else side.residual
    n = len(series)
    single = recording.repeats == 1
    window = np.hanning(n) if single else np.ones(n)
    amplitude = 2 * np.abs(np.fft.rfft((series - series.mean(axis=0)) * window[:, None], axis=0))[1:] / window.sum()
    frequency = np.asarray(np.fft.rfftfreq(n, step_of(recording))[1:], dtype=np.float64)
    index = np.arange(1, len(frequency) + 1)
    motion = np.zeros(len(index), dtype=bool) if single else index % (recording.repeats if whole else 1) == 0
    averaged = 1 if whole else recording.repeats
    noise = _noise_amplitude(side, frequency, float((window**2).sum() / window.sum() ** 2 / averaged))
    return Lines(frequency, amplitude, motion, noise)


def _noise_amplitude(side: Side, frequency: Array, gain: float) -> Array | None:
    """2 sqrt(S gain): the RMS amplitude of noise of the spectrum S per sample."""
    noise = side.comparison.noise
    if noise.spectra:
        return np.stack([2 * np.sqrt(s(frequency) * gain) for s in noise.spectra], axis=1)
    if noise.source is NoiseSource.RIG:
        return np.asarray(np.tile(2 * side.floor * np.sqrt(gain), (len(frequency), 1)))
    return None


def spectrum_figure(sides: Sequence[Side]) -> Figure:
    """Every channel, a column for each side: all lines in grey, the motion's as points, the noise as a curve."""
    labels = channel_labels(sides)
    sheet = Sheet(rows=len(labels), columns=len(sides), panel_height=105, top=44)
    figure, panels = sheet.panels(sharex=True, sharey="row")
    for column, side in enumerate(sides):
        lines = lines_of(side)
        heading(panels[0, column], side.label, side.colour)
        for row, (name, unit) in enumerate(labels):
            axes = panels[row, column]
            axes.set_xscale("log")
            axes.set_yscale("log")
            _channel(axes, lines, row, side.colour)
            if not column:
                name_y(axes, labelled(f"{name} amplitude", unit))
        panels[-1, column].set_xlabel("frequency (Hz)")
    for row in range(len(labels)):
        panels[row, 0].set_ylim(*_limits(sides, row))
    figure.legend(*_all_handles(panels[0]), **LEGEND, ncols=4, loc="upper right", borderaxespad=0.2)
    return figure


def _all_handles(panels: Iterable[Axes]) -> tuple[list[Any], list[str]]:
    """Each thing drawn in any of the panels once."""
    found: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        found = dict(zip(labels, handles, strict=True)) | found
    return list(found.values()), list(found)


def _limits(sides: Sequence[Side], channel: int) -> tuple[float, float]:
    """From well below the middle line to above the highest."""
    amplitude = np.concatenate([lines_of(side).amplitude[:, channel] for side in sides])
    middle, top = float(np.median(amplitude)), float(amplitude.max())
    return max(middle / 8, 1e-12), max(top, middle, 1e-11) * 2


def _channel(axes: Axes, lines: Lines, channel: int, colour: str) -> None:
    amplitude = lines.amplitude[:, channel]
    rest = ~lines.motion
    label = "between the motion's lines" if lines.motion.any() else "amplitude"
    if rest.any():
        axes.plot(*_thinned(lines.frequency[rest], amplitude[rest]), color=FAINT, lw=0.7, label=label)
    if lines.motion.any():
        _motion_lines(axes, lines, channel, colour)
    else:
        axes.plot(*_smoothed(lines.frequency, amplitude), color=colour, lw=1.3, label="RMS over a band")
    if lines.noise is not None:
        shown = np.unique(np.geomspace(1, len(lines.frequency), 200).astype(int)) - 1
        axes.plot(lines.frequency[shown], lines.noise[shown, channel], color=INK, lw=1.0, ls="--", label="noise")


def _motion_lines(axes: Axes, lines: Lines, channel: int, colour: str) -> None:
    frequency, amplitude = lines.frequency[lines.motion], lines.amplitude[lines.motion, channel]
    if lines.noise is None:
        axes.plot(frequency, amplitude, "o", ms=3.2, color=colour, label="lines of the motion")
        return
    noise = lines.noise[lines.motion, channel]
    loud = amplitude > noise * np.sqrt(np.log(len(amplitude) / FALSE_ALARM))
    axes.plot(frequency[~loud], amplitude[~loud], "o", ms=1.8, color=MEASURED, mew=0, label="motion's lines, as noise")
    axes.vlines(frequency[loud], noise[loud], amplitude[loud], color=colour, lw=1.0)
    axes.plot(frequency[loud], amplitude[loud], "o", ms=3.6, color=colour, label="above the noise")


def _thinned(frequency: Array, amplitude: Array) -> tuple[Array, Array]:
    """The lowest and highest line in each column of pixels of a logarithmic axis."""
    place = np.floor(BINS * np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])).astype(int)
    if len(frequency) < 2 * BINS:
        return frequency, amplitude
    kept = set()
    for value in np.unique(place):
        inside = np.flatnonzero(place == value)
        kept |= {int(inside[amplitude[inside].argmin()]), int(inside[amplitude[inside].argmax()])}
    index = np.array(sorted(kept))
    return frequency[index], amplitude[index]


def _smoothed(frequency: Array, amplitude: Array) -> tuple[Array, Array]:
    """RMS amplitude over bands of equal width on a logarithmic axis."""
    edges = np.unique(np.geomspace(1, len(frequency) + 1, 80).astype(int)) - 1
    pairs = list(pairwise(edges))
    centre = np.array([frequency[a:b].mean() for a, b in pairs])
    return centre, np.array([np.sqrt((amplitude[a:b] ** 2).mean()) for a, b in pairs])
