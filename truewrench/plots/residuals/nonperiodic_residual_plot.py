"""Non-periodic part of the residual over the record (drift, transients)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.noise.recording_noise import sample_step
from modeling.number_format import axis_label
from truewrench.plots.fitted_grid import fit_grid
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.style import HELD_OUT, MUTED, NOISE, PanelGrid, panel_title

Array = NDArray[np.float64]

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
    axes.plot(time, means, color=colour, lw=1.2, drawstyle="steps-mid")
    axes.margins(x=0.01)


def nonperiodic_residual(side: LabelledComparison) -> tuple[Array, Array]:
    """Middle of each interval (s), and the mean there of the residual less its periodic part, (intervals, p)."""
    recording = side.recording
    residual = side.comparison.residual
    blocks = (residual - recording.averaged(residual)).reshape(recording.repeats, recording.samples_per_repeat, -1)
    parts = min(INTERVALS, recording.samples_per_repeat)
    means = [part.mean(axis=1) for part in np.array_split(blocks, parts, axis=1)]
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
