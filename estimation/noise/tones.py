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
from estimation.noise.transient_windows import EventShape
from estimation.recordings.recording import Recording
from modeling.effects.disturbances import BiasDrift
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
PERIODIC_ROUNDING = 1e-9
"""Mean square of a sinusoid less its periodic part that counts as rounding: within a 20 000th of an excited line."""
MEDIAN_OF_EXPONENTIAL = float(np.log(2))
"""Median of a periodogram's ordinate over its mean."""


@dataclass(frozen=True, eq=False)
class NonperiodicResidual:
    """A residual (n, p) less its mean over the repeats and less known tones (Hz)."""

    recording: Recording
    residual: Array
    known: tuple[float, ...] = ()

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

    def explained_power(self, frequencies: Array) -> Array:
        """Sum of squares (f, p) that a sinusoid of each frequency (Hz) explains, less its own periodic part.

        Zero at an excited line, where nothing else of it is left.
        """
        angles = 2 * np.pi * sample_step(self.recording) * frequencies
        products = _fourier_sums(self.nonperiodic, angles)  # the sinusoid's periodic part is orthogonal to it
        n, repeats, period = len(self.residual), self.recording.repeats, self.recording.samples_per_repeat
        mean = _phase_sums(period * angles, repeats) / repeats
        of_all = _wave_gram(n, _phase_sums(2 * angles, n))
        of_mean = repeats * _wave_gram(period * np.abs(mean) ** 2, mean**2 * _phase_sums(2 * angles, period))
        waves = np.stack([products.real, products.imag], axis=1)  # (f, 2, p)
        squares, directions = np.linalg.eigh(of_all - of_mean)
        along = directions.swapaxes(1, 2) @ waves
        left = squares > PERIODIC_ROUNDING * n
        return np.asarray((along**2 * (left / np.where(left, squares, 1.0))[:, :, None]).sum(axis=1))

    def sharpened(self, line: float, weight: Array) -> float:
        """Frequency (Hz) within a line of `line` at which a sinusoid explains most of the residual's power.

        Channels count by `weight` (p,), one over their noise power. The sinusoid's periodic part is removed too, so
        that the excited lines, on which a tone is aliased with physics, do not bias the frequency.
        """
        duration = len(self.residual) * sample_step(self.recording)

        def negative_explained_power(frequencies: Array) -> Array:
            return np.asarray(-self.explained_power(frequencies) @ weight)

        near = (line + np.linspace(-1.0, 1.0, 17)) / duration
        best = int(np.argmin(negative_explained_power(near)))
        ends = near[max(best - 1, 0)], near[min(best + 1, len(near) - 1)]
        smooth = Chebyshev.interpolate(negative_explained_power, CHEBYSHEV_DEGREE, domain=ends)
        roots = smooth.deriv().roots()
        inside = roots.real[(np.abs(roots.imag) < 1e-9 / duration) & (ends[0] < roots.real) & (roots.real < ends[1])]
        return float(min((*ends, *inside), key=smooth))


def _fourier_sums(series: Array, angles: Array) -> NDArray[np.complex128]:
    """Sums (f, p) of x_t exp(i w t) over a series (n, p) at any angles w per sample (f,).

    In blocks: exp(i w (b B + s)) = exp(i w b B) exp(i w s), so that few of the exponentials are computed.
    """
    n, p = series.shape
    size = max(int(np.sqrt(n)), 1)
    blocks = np.zeros((-(-n // size) * size, p))
    blocks[:n] = series
    blocks = blocks.reshape(-1, size, p)
    steps, starts = np.arange(size), size * np.arange(len(blocks))
    within, before = (np.exp(1j * np.multiply.outer(angles, t)) for t in (steps, starts))
    real, imaginary = np.split(np.vstack([within.real, within.imag]) @ blocks, 2, axis=1)  # (b, f, p) each
    return np.asarray(np.einsum("fb,bfp->fp", before, real + 1j * imaginary))


def _phase_sums(angles: Array, count: int) -> NDArray[np.complex128]:
    """Sums (f,) of exp(i w t) over t = 0 .. count - 1.

    w is taken from the nearest full turn: at one, sin(N w / 2) / sin(w / 2) is a quotient of two roundings.
    """
    turns = angles / (2 * np.pi)
    half = np.pi * (turns - np.rint(turns))
    sine = np.sin(half)
    ratio = np.where(sine == 0, count, np.sin(count * half) / np.where(sine == 0, 1.0, sine))
    return np.asarray(ratio * np.exp(1j * (count - 1) * half))


def _wave_gram(squares: Array | float, double: NDArray[np.complex128]) -> Array:
    """Inner products (f, 2, 2) of the real and imaginary parts of a series z, from sums of |z|² and of z²."""
    real, both, imaginary = (squares + double.real) / 2, double.imag / 2, (squares - double.real) / 2
    return np.moveaxis(np.array([[real, both], [both, imaginary]]), 2, 0)


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
    count = np.isfinite(values).sum(axis=0, keepdims=True)
    middle = [np.take_along_axis(ordered, place, axis=0)[0] for place in ((count - 1) // 2, count // 2)]
    return np.asarray(sum(middle) / 2)


def find_tones(recording: Recording, residual: Array) -> tuple[float, ...]:
    """Frequencies (Hz) of significant sinusoids in a residual (n, p) not locked to the motion, strongest first.

    Only continuous repeats have non-excited lines. One after another the strongest line of any channel is tested,
    Bonferroni-corrected for lines and channels (1 in 1000), its frequency refined below the line spacing, and its
    sinusoid subtracted, so that its leakage is not found as another.
    """
    if recording.repeats < 2 or not recording.continuous:
        return ()
    frequencies: list[float] = []
    for _ in range(MAX_TONES):
        remaining = NonperiodicResidual(recording, residual, tuple(frequencies))
        if remaining.power.size == 0 or remaining.power.max() < np.log(remaining.power.size / LEVELS.tone):
            break
        line, _channel = np.unravel_index(int(remaining.power.argmax()), remaining.power.shape)
        level = np.abs(np.fft.rfft(remaining.nonperiodic, axis=0)[remaining.lines[line]]) ** 2 / np.maximum(
            remaining.power[line], 1e-300
        )
        frequencies.append(remaining.sharpened(float(remaining.lines[line]), 1 / np.maximum(level, 1e-300)))
    return tuple(frequencies)


def sinusoids(recording: Recording, frequencies: Sequence[float]) -> Array:
    """Sines and cosines (n, 2 k) of k frequencies (Hz) over a recording."""
    time = _time(recording)
    angle = 2 * np.pi * np.multiply.outer(time, np.asarray(frequencies, dtype=float))
    return np.hstack([np.sin(angle), np.cos(angle)])


def without_sinusoids(residual: Array, recording: Recording, frequencies: Sequence[float]) -> Array:
    """A residual (n, p) less the sinusoids of these frequencies (Hz) that fit it best."""
    if not frequencies:
        return residual
    waves = sinusoids(recording, frequencies)
    return np.asarray(residual - waves @ np.linalg.lstsq(waves, residual, rcond=None)[0])


DRIFT_DEGREE = BiasDrift().degree
"""Degree of the polynomials that count as drift, not noise: four half-waves over the record to 0.1 % of power."""


def disturbance_basis(
    recording: Recording,
    events: Sequence[tuple[float, float]],
    tones: Sequence[float] = (),
    shapes: Sequence[EventShape] = (),
) -> Array:
    """Orthonormal basis (n, k) of drift, auxiliary signals, events (s), tones (Hz) and events of any shape, less their
    mean over repeats."""
    n = recording.samples
    columns = list(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), DRIFT_DEGREE)[:, 1:].T)
    columns += [recording.signals[name] for name in recording.auxiliary]
    columns += list(pulses(recording, events).T)
    columns += list(sinusoids(recording, tones).T)
    columns += [column for shape in shapes for column in shape.columns(_time(recording)).T]
    series = np.stack(columns, axis=1)
    nonperiodic = series - recording.averaged(series)
    scale = np.linalg.norm(nonperiodic, axis=0)
    nonperiodic = nonperiodic[:, scale > 1e-12 * max(scale.max(), 1e-300)]
    left, singular, _ = np.linalg.svd(nonperiodic / np.linalg.norm(nonperiodic, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])


def pulses(recording: Recording, events: Sequence[tuple[float, float]]) -> Array:
    """Series (n, k) that are 1 during each of the events (s), else 0."""
    time = _time(recording)
    within = [(time >= start) & (time < end) for start, end in events]
    return np.stack(within, axis=1).astype(np.float64) if within else np.zeros((len(time), 0))


def shape_columns(recording: Recording, shapes: Sequence[EventShape]) -> Array:
    """Series (n, k) of what events of any shape have that no effect is judged by."""
    columns = [shape.unjudged_columns(_time(recording)) for shape in shapes]
    return np.hstack(columns) if columns else np.zeros((recording.samples, 0))


def without_shapes(residual: Array, recording: Recording, shapes: Sequence[EventShape]) -> Array:
    """A residual (n, p) less what events of any shape explain."""
    if not shapes:
        return residual
    columns = shapes[0].columns(_time(recording))
    return without_shapes(np.asarray(residual - columns @ (columns.T @ residual)), recording, shapes[1:])


def _time(recording: Recording) -> Array:
    """Seconds (n,) from the first sample."""
    return np.asarray(np.arange(recording.samples) * sample_step(recording), dtype=np.float64)
