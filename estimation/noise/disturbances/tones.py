"""Sinusoidal disturbances (tones) on non-excited lines of a periodic recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

from estimation.noise.power_spectrum import power_levels, smooth_power_spectra
from estimation.noise.recording_noise import sample_step
from estimation.recordings.recording import Recording
from modeling.significance import LEVELS

Array = NDArray[np.float64]

MAX_TONES = 4
"""Tones searched for in a recording at the most."""
NEIGHBOURING_LINES = (3, 12)
"""Lines on either side whose median a tone must exceed: an event or a step raises all of them."""
MAIN_LOBE_LINES = 2.0
"""Lines about a known tone that its residual may still raise."""
CHEBYSHEV_DEGREE = 6
"""Degree that approximates the power over a quarter of a line; its maximum is right to a hundred-thousandth."""
MEDIAN_OF_EXPONENTIAL = float(np.log(2))
"""Median of a periodogram's ordinate over its mean."""


@dataclass(frozen=True, eq=False)
class NonperiodicResidual:
    """A residual (n, p) less its mean over the repeats and less known tones (Hz)."""

    recording: Recording
    residual: Array
    known: tuple[float, ...] = ()

    @cached_property
    def time(self) -> Array:
        """Time since the first sample, s."""
        return np.asarray(np.arange(len(self.residual)) * sample_step(self.recording), dtype=np.float64)

    @cached_property
    def nonperiodic(self) -> Array:
        """The residual less the known tones and its periodic part, (n, p)."""
        remaining = without_sinusoids(self.residual, self.recording, self.known)
        return np.asarray(remaining - self.recording.averaged(remaining))

    @cached_property
    def lines(self) -> NDArray[np.intp]:
        """Non-excited lines above the first excited one, where drift is small, and not next to a known tone."""
        duration = len(self.residual) * sample_step(self.recording)
        index = np.arange(1, (len(self.residual) - 1) // 2 + 1)
        near_tones = [np.abs(index - f * duration) < MAIN_LOBE_LINES for f in self.known]
        non_excited = (index % self.recording.repeats != 0) & (index > self.recording.repeats)
        return np.asarray(index[non_excited & ~np.any(near_tones or [index < 0], axis=0)])

    @cached_property
    def power(self) -> Array:
        """Periodogram (lines, p) over the noise spectrum or the neighbouring lines' level, whichever is larger."""
        n = len(self.residual)
        ordinates = np.abs(np.fft.rfft(self.nonperiodic, axis=0)[self.lines]) ** 2 / n
        frequency = self.lines / (n * sample_step(self.recording))
        level = power_levels(smooth_power_spectra(frequency, ordinates), frequency)
        return np.asarray(ordinates / np.maximum(level, _neighbouring_power(ordinates)))

    def sharpened(self, line: float, weight: Array) -> float:
        """Frequency (Hz) within a line of `line` at which a sinusoid explains most of the residual's power.

        Channels count by `weight` (p,), one over their noise power. The sinusoid's periodic part is removed too, so
        that the excited lines, on which a tone is aliased with physics, do not bias the frequency.
        """
        duration = len(self.residual) * sample_step(self.recording)

        def negative_explained_power(frequency: float) -> float:
            angle = 2 * np.pi * frequency * self.time[:, None]
            waves = np.hstack([np.sin(angle), np.cos(angle)])
            waves -= self.recording.averaged(waves)
            products = waves.T @ self.nonperiodic
            amplitudes = np.linalg.lstsq(waves.T @ waves, products, rcond=None)[0]
            return -float((products * amplitudes).sum(axis=0) @ weight)

        near = (line + np.linspace(-1.0, 1.0, 17)) / duration
        best = int(np.argmin([negative_explained_power(f) for f in near]))
        ends = near[max(best - 1, 0)], near[min(best + 1, len(near) - 1)]
        smooth = Chebyshev.interpolate(np.vectorize(negative_explained_power), CHEBYSHEV_DEGREE, domain=ends)
        roots = smooth.deriv().roots()
        inside = roots.real[(np.abs(roots.imag) < 1e-9 / duration) & (ends[0] < roots.real) & (roots.real < ends[1])]
        return float(min((*ends, *inside), key=smooth))


def _neighbouring_power(ordinates: Array) -> Array:
    """Mean ordinate (lines, p) estimated from the median over neighbouring lines."""
    first, last = NEIGHBOURING_LINES
    shifts = [s for s in range(-last, last + 1) if abs(s) >= first]
    padded = np.pad(ordinates, ((last, last), (0, 0)), constant_values=np.nan)
    near = np.stack([padded[last + s : last + s + len(ordinates)] for s in shifts])
    return _median_of_known(near) / MEDIAN_OF_EXPONENTIAL


def _median_of_known(values: Array) -> Array:
    """Median over the first axis of what is not NaN; `numpy.nanmedian` takes ten times as long for few values."""
    ordered = np.sort(values, axis=0)  # NaN last
    known = np.isfinite(values).sum(axis=0, keepdims=True)
    middle = [np.take_along_axis(ordered, place, axis=0)[0] for place in ((known - 1) // 2, known // 2)]
    return np.asarray(sum(middle) / 2)


def find_tones(recording: Recording, residual: Array) -> tuple[float, ...]:
    """Frequencies (Hz) of significant sinusoids in a residual (n, p) not locked to the motion, strongest first.

    Only continuous repeats have non-excited lines. One after another the strongest line of any channel is tested,
    Bonferroni-corrected for lines and channels (1 in 1000), its frequency refined below the line spacing, and its
    sinusoid subtracted, so that its leakage is not found as another.
    """
    if recording.repeats < 2 or not recording.continuous:
        return ()
    found: list[float] = []
    for _ in range(MAX_TONES):
        remaining = NonperiodicResidual(recording, residual, tuple(found))
        if remaining.power.size == 0 or remaining.power.max() < np.log(remaining.power.size / LEVELS.tone):
            break
        line, _channel = np.unravel_index(int(remaining.power.argmax()), remaining.power.shape)
        level = np.abs(np.fft.rfft(remaining.nonperiodic, axis=0)[remaining.lines[line]]) ** 2 / np.maximum(
            remaining.power[line], 1e-300
        )
        found.append(remaining.sharpened(float(remaining.lines[line]), 1 / np.maximum(level, 1e-300)))
    return tuple(found)


def sinusoids(recording: Recording, frequencies: Sequence[float]) -> Array:
    """Sines and cosines (n, 2 k) of k frequencies (Hz) over a recording."""
    time = np.arange(recording.samples) * sample_step(recording)
    angle = 2 * np.pi * np.multiply.outer(time, np.asarray(frequencies, dtype=float))
    return np.hstack([np.sin(angle), np.cos(angle)])


def without_sinusoids(residual: Array, recording: Recording, frequencies: Sequence[float]) -> Array:
    """A residual (n, p) less the sinusoids of these frequencies (Hz) that fit it best."""
    if not frequencies:
        return residual
    waves = sinusoids(recording, frequencies)
    return np.asarray(residual - waves @ np.linalg.lstsq(waves, residual, rcond=None)[0])
