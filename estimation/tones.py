"""Tones: sinusoids of fixed frequency in a recording with repeats that are not locked to its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

from estimation.noise import step_of
from estimation.recording import Recording
from estimation.spectrum import smooth_spectrum

Array = NDArray[np.float64]

MOST_TONES = 4
CHANCE = 1e-3
"""Chance of taking one line of a record without tones for a tone."""
NEIGHBOURS = (3, 12)
"""Lines on either side whose median a tone has to stand out of: a push or a step is loud on all of them."""
BESIDE = 2.0
"""Lines about a tone on which what is left of it may stand out still."""
SMOOTH = 6
"""Degree of a polynomial that is the power over a quarter of a line, its highest place to a hundred-thousandth."""
MEDIAN = float(np.log(2))
"""Of a periodogram's ordinate over its mean."""


@dataclass(frozen=True, eq=False)
class Between:
    """A residual (n, p) where nothing that repeats is seen: less its mean over the repeats, and known tones (Hz)."""

    recording: Recording
    residual: Array
    known: tuple[float, ...] = ()

    def without_motion(self, series: Array) -> Array:
        """A series (n, ...) less what repeats in it."""
        blocks = series.reshape(self.recording.repeats, -1, *series.shape[1:])
        return np.asarray((blocks - blocks.mean(axis=0)).reshape(series.shape))

    @cached_property
    def time(self) -> Array:
        """Since the first sample, s."""
        return np.asarray(np.arange(len(self.residual)) * step_of(self.recording), dtype=np.float64)

    @cached_property
    def seen(self) -> Array:
        """The residual less the known tones and what repeats, (n, p)."""
        return self.without_motion(without(self.residual, self.recording, self.known))

    @cached_property
    def lines(self) -> NDArray[np.intp]:
        """Lines between the motion's, above its first, where drift hardly reaches, and not beside a known tone."""
        duration = len(self.residual) * step_of(self.recording)
        index = np.arange(1, (len(self.residual) - 1) // 2 + 1)
        taken = [np.abs(index - f * duration) < BESIDE for f in self.known]
        between = (index % self.recording.repeats != 0) & (index > self.recording.repeats)
        return np.asarray(index[between & ~np.any(taken or [index < 0], axis=0)])

    @cached_property
    def power(self) -> Array:
        """Periodogram (lines, p) over the noise's spectrum, or over the neighbouring lines where those are louder."""
        n = len(self.residual)
        ordinates = np.abs(np.fft.rfft(self.seen, axis=0)[self.lines]) ** 2 / n
        frequency = self.lines / (n * step_of(self.recording))
        level = np.stack([smooth_spectrum(frequency, column)(frequency) for column in ordinates.T], axis=1)
        return np.asarray(ordinates / np.maximum(level, _local_level(ordinates)))

    def sharpened(self, line: float, weight: Array) -> float:
        """Frequency (Hz) within a line of `line` at which a sinusoid takes most of the residual's power.

        Channels count by `weight` (p,), one over their noise's power. What repeats is taken out of the sinusoid too,
        so that the motion's lines, on which a tone cannot be told from physics, do not pull it to them.
        """
        duration = len(self.residual) * step_of(self.recording)

        def missed(frequency: float) -> float:
            angle = 2 * np.pi * frequency * self.time[:, None]
            waves = self.without_motion(np.hstack([np.sin(angle), np.cos(angle)]))
            along = waves.T @ self.seen
            amounts = np.linalg.lstsq(waves.T @ waves, along, rcond=None)[0]
            return -float((along * amounts).sum(axis=0) @ weight)

        near = (line + np.linspace(-1.0, 1.0, 17)) / duration
        best = int(np.argmin([missed(f) for f in near]))
        ends = near[max(best - 1, 0)], near[min(best + 1, len(near) - 1)]
        smooth = Chebyshev.interpolate(np.vectorize(missed), SMOOTH, domain=ends)
        turns = smooth.deriv().roots()
        inside = turns.real[(np.abs(turns.imag) < 1e-9 / duration) & (ends[0] < turns.real) & (turns.real < ends[1])]
        return float(min((*ends, *inside), key=smooth))


def _local_level(ordinates: Array) -> Array:
    """Mean that the median of the neighbouring lines' ordinates (lines, p) stands for."""
    first, last = NEIGHBOURS
    shifts = [s for s in range(-last, last + 1) if abs(s) >= first]
    padded = np.pad(ordinates, ((last, last), (0, 0)), constant_values=np.nan)
    near = np.stack([padded[last + s : last + s + len(ordinates)] for s in shifts])
    return np.asarray(np.nanmedian(near, axis=0) / MEDIAN)


def find_tones(recording: Recording, residual: Array) -> tuple[float, ...]:
    """Frequencies (Hz) of sinusoids in a residual (n, p) that are no noise and not the motion's, loudest first.

    Only repeats in one go have lines between the motion's on which to look. One after another the loudest line of any
    channel is taken, all lines and channels paid for (1 in 1000), its frequency sharpened below the lines' spacing, and
    its sinusoid taken out, so that what leaks from it is not taken for another.
    """
    if recording.repeats < 2 or not recording.continuous:
        return ()
    found: list[float] = []
    for _ in range(MOST_TONES):
        left = Between(recording, residual, tuple(found))
        if left.power.size == 0 or left.power.max() < np.log(left.power.size / CHANCE):
            break
        line, _channel = np.unravel_index(int(left.power.argmax()), left.power.shape)
        level = np.abs(np.fft.rfft(left.seen, axis=0)[left.lines[line]]) ** 2 / np.maximum(left.power[line], 1e-300)
        found.append(left.sharpened(float(left.lines[line]), 1 / np.maximum(level, 1e-300)))
    return tuple(found)


def sinusoids(recording: Recording, frequencies: Sequence[float]) -> Array:
    """Sines and cosines (n, 2 k) of k frequencies (Hz) over a recording."""
    time = np.arange(recording.samples) * step_of(recording)
    angle = 2 * np.pi * np.multiply.outer(time, np.asarray(frequencies, dtype=float))
    return np.hstack([np.sin(angle), np.cos(angle)])


def without(residual: Array, recording: Recording, frequencies: Sequence[float]) -> Array:
    """A residual (n, p) less the sinusoids of these frequencies (Hz) that fit it best."""
    if not frequencies:
        return residual
    waves = sinusoids(recording, frequencies)
    return np.asarray(residual - waves @ np.linalg.lstsq(waves, residual, rcond=None)[0])
