"""Systematic error of each channel in octaves of frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from estimation.noise.recording_noise import NoiseSource, sample_step
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]

MAX_BANDS = 8
"""Octaves from the highest frequency down; all lower ones are one band."""


@dataclass(frozen=True, eq=False)
class BandError(Tabular):
    """RMS of a residual in frequency bands.

    edges       (b + 1,) Hz; the mean over the record is left out
    rms         (b, p) in the channels' units: with repeats of the part that repeats (systematic), else of the whole
    systematic  which of the two
    """

    comparison: Comparison
    edges: Array
    rms: Array
    systematic: bool

    @classmethod
    def of(cls, comparison: Comparison) -> BandError:
        """The bands of a compared recording.

        With R repeats the power of a harmonic that repeats is the mean of X_r X_s* over all pairs of different
        repeats, to which independent noise adds nothing on average; negative sums over a band are noise, and zero.
        """
        recording, step = comparison.recording, sample_step(comparison.recording)
        systematic = comparison.noise.source is NoiseSource.REPEATS
        repeats = recording.repeats if systematic else 1
        blocks = comparison.residual.reshape(repeats, -1, comparison.residual.shape[1])
        lines = np.fft.rfft(blocks, axis=1)[:, 1:] / blocks.shape[1]
        power = _repeating_power(lines) if systematic else np.abs(lines[0]) ** 2
        frequency = np.fft.rfftfreq(blocks.shape[1], step)[1:].astype(np.float64)
        weight = np.where(np.isclose(frequency, 0.5 / step), 1.0, 2.0)
        edges = octaves(frequency)
        band = np.searchsorted(edges, frequency, side="right") - 1
        sums = [(weight[:, None] * power)[band == b].sum(axis=0) for b in range(len(edges) - 1)]
        return cls(comparison, edges, np.sqrt(np.maximum(sums, 0.0)), systematic)

    def above(self, share: float) -> NDArray[np.bool_]:
        """Bands (b,) in which a channel's RMS exceeds this share of its noise floor."""
        floor = np.array(list(self.comparison.noise_floor.values()))
        return np.asarray((self.rms > share * floor).any(axis=1))

    @property
    def labels(self) -> list[str]:
        """Each band as text, Hz."""
        return [f"{low:.3g} to {high:.3g}" for low, high in zip(self.edges[:-1], self.edges[1:], strict=True)]

    @property
    def table(self) -> Table:
        """Bands and the RMS of each channel."""
        units = self.comparison.space.channel_units.items()
        numbers = (Column(c, unit, format=".3g") for c, unit in units)
        rows: list[tuple[Value, ...]] = [
            (label, *map(float, r)) for label, r in zip(self.labels, self.rms, strict=True)
        ]
        return Table.of((Column("band", "Hz"), *numbers), rows)

    def remarks(self) -> list[str]:
        """What the numbers are."""
        kind = "of the part that repeats with the motion" if self.systematic else "of the whole residual: no repeats"
        return [f"RMS {kind}"]


def _repeating_power(lines: NDArray[np.complex128]) -> Array:
    """Mean over pairs of different repeats of X_r X_s*, of lines (repeats, lines, p)."""
    repeats = len(lines)
    pairs = np.abs(lines.sum(axis=0)) ** 2 - (np.abs(lines) ** 2).sum(axis=0)
    return np.asarray(pairs / (repeats * (repeats - 1)))


def octaves(frequency: Array) -> Array:
    """Edges (b + 1,) in Hz: halves of the highest frequency, down to the lowest or to MAX_BANDS bands."""
    highest, lowest = float(frequency[-1]), float(frequency[0])
    count = min(MAX_BANDS, max(1, int(np.ceil(np.log2(highest / lowest)))))
    inner = highest / 2.0 ** np.arange(count - 1, 0, -1)
    return np.array([lowest * (1 - 1e-9), *inner, highest * (1 + 1e-9)])
