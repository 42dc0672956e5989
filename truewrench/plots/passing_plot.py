"""Passing plot: what does not repeat, over the whole record: drift, a warming sensor, a push, a lost payload."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.noise import step_of
from truewrench.plots.number import labelled
from truewrench.plots.side import Side, channel_labels
from truewrench.plots.style import HELD_OUT, MUTED, NOISE, Sheet, heading, name_y

Array = NDArray[np.float64]

PARTS = 8
"""Stretches of a repeat over which it is averaged."""


def passing_figure(sides: Sequence[Side]) -> Figure:
    """Every channel over the whole record, less what repeats, averaged over parts of a repeat; ± 2 std of that."""
    labels = channel_labels(sides)
    figure, panels = Sheet(rows=len(labels), columns=len(sides), panel_height=80).panels(sharex=True, sharey="row")
    for column, side in enumerate(sides):
        time, left = passing(side)
        spread = spread_of_means(side)
        heading(panels[0, column], side.label, side.colour)
        for row, (name, unit) in enumerate(labels):
            axes = panels[row, column]
            axes.axhspan(-2 * spread[row], 2 * spread[row], color=NOISE, lw=0, zorder=0)
            axes.axhline(0, color=MUTED, lw=0.5, zorder=0.2)
            for start, end in side.comparison.noise.events:
                axes.axvspan(start, end, color=HELD_OUT, alpha=0.25, lw=0, zorder=0.1)
            axes.plot(time, left[:, row], color=side.colour, lw=1.1, drawstyle="steps-mid")
            axes.margins(x=0.01)
            if not column:
                name_y(axes, labelled(name, unit))
        panels[-1, column].set_xlabel("time in the record (s)")
    return figure


def passing(side: Side) -> tuple[Array, Array]:
    """Middle of each stretch (s), and the mean there of what is left less what repeats, (stretches, p)."""
    recording = side.recording
    residual = side.comparison.residual
    blocks = (residual - recording.averaged(residual)).reshape(recording.repeats, recording.samples_per_repeat, -1)
    parts = min(PARTS, recording.samples_per_repeat)
    means = [part.mean(axis=1) for part in np.array_split(blocks, parts, axis=1)]
    left = np.stack(means, axis=1).reshape(recording.repeats * parts, -1)
    span = recording.samples * step_of(recording) / len(left)
    return np.asarray((np.arange(len(left)) + 0.5) * span), np.asarray(left)


def spread_of_means(side: Side) -> Array:
    """Std of the mean over one stretch from the noise's spectrum, less what the mean over repeats takes away; (p,).

    The mean over L of N samples weighs |X_k|² = N S_k with |B_k|² / N², B the transform of a box of 1/L.
    """
    recording = side.recording
    n, repeats = recording.samples, recording.repeats
    box = np.zeros(n)
    length = max(1, recording.samples_per_repeat // PARTS)
    box[:length] = 1 / length
    gain = np.abs(np.fft.rfft(box)[1:]) ** 2
    frequency = np.asarray(np.fft.rfftfreq(n, step_of(recording))[1:], dtype=np.float64)
    levels = np.stack([s(frequency) for s in side.comparison.noise.spectra], axis=1)
    return np.asarray(np.sqrt(2 * (gain[:, None] * levels).sum(axis=0) / n * (1 - 1 / repeats)))
