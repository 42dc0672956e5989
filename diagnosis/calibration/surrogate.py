"""Surrogate noise: readings noise with the spectra and coherence of a residual, by resampling its Fourier lines.

Local bootstrap of the periodogram (Paparoditis and Politis, 1999): each Fourier line of a surrogate is that of a
neighbour, all channels together, with one uniformly distributed phase. Neighbours are lines on which the residual is
noise: all of a single run, the non-excited ones of a recording with repeats. Whatever is not in a spectrum (bursts,
contact, the shape of a distribution) is lost: a surrogate is stationary and nearly normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.recording import Recording

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

NEAREST = 8
"""Neighbours of a line, at the most; wider means more different surrogates, of a smoother spectrum."""
SPREAD = 4
"""A line's neighbours lie within this part of its frequency, so that a steep spectrum stays steep."""


def surrogate_noise(recording: Recording, residual: Array, rng: np.random.Generator) -> Array:
    """Noise (n, p) like that in a residual (n, p) of a recording, in the channels' units."""
    if recording.repeats > 1 and not recording.continuous:
        return _of_separate_runs(recording, residual, rng)
    index = np.arange(len(residual) // 2 + 1)
    donors = index[1:] if recording.repeats == 1 else index[index % recording.repeats != 0]
    lines = np.fft.rfft(residual, axis=0)
    return _series(_resampled(lines, donors, rng), len(residual))


def _of_separate_runs(recording: Recording, residual: Array, rng: np.random.Generator) -> Array:
    """Each run from the differences between the runs, whose mean holds what repeats with the motion."""
    repeats, period = recording.repeats, recording.samples_per_repeat
    runs = residual.reshape(repeats, period, -1)
    differences = (runs - runs.mean(axis=0)) * np.sqrt(repeats / (repeats - 1))
    lines = np.fft.rfft(differences, axis=1)
    donors = np.arange(lines.shape[1])
    drawn = [_resampled(lines[run], donors, rng, constant=True) for run in rng.integers(repeats, size=repeats)]
    return np.concatenate([_series(each, period) for each in drawn])


def _resampled(lines: Lines, donors: NDArray[np.intp], rng: np.random.Generator, *, constant: bool = False) -> Lines:
    """Every line from one of the donors near it; the mean of the channels is zero unless it is noise, too."""
    index = np.arange(len(lines))
    first = np.searchsorted(donors, index)
    reach = np.clip(index // (2 * SPREAD), 0, NEAREST // 2)
    low, high = np.maximum(first - reach, 0), np.minimum(first + reach, len(donors) - 1)
    place = np.minimum(rng.integers(np.minimum(low, high), high + 1), len(donors) - 1)
    phase = np.exp(2j * np.pi * rng.random(len(lines)))
    found: Lines = lines[donors[place]] * phase[:, None]
    if not constant:
        found[0] = 0.0
    return found


def _series(lines: Lines, samples: int) -> Array:
    """The real series (n, p) of these lines; the first and the last, which are real, keep their power."""
    ends = [0, -1] if samples % 2 == 0 else [0]
    lines[ends] = np.abs(lines[ends]) * np.sign(lines[ends].real + 1e-300)
    return np.asarray(np.fft.irfft(lines, samples, axis=0))
