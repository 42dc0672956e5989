"""Spectrum of what whitening leaves of a single run's residual, by its fit."""

from __future__ import annotations

from estimation.fit import Fit
from estimation.fit_column_space import fit_column_space
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from estimation.noise.whitened_spectrum import MIN_ROWS, WhitenedSpectrum, lines
from estimation.recordings.recording import Recording


def has_run_spectrum(recording: Recording, noise: RecordingNoise) -> bool:
    """Whether the spectrum is estimated: not with repeats, which measure it, of poses, and of too short a run."""
    rows = noise.whitener.rows // len(recording.channels)
    return noise.source is not NoiseSource.REPEATS and not recording.at_rest and rows >= MIN_ROWS


def run_spectrum(fit: Fit, number: int) -> WhitenedSpectrum | None:
    """Of the recording of that number, the fit's parameters projected out; None as `has_run_spectrum` has it."""
    recording, noise = fit.recordings[number], fit.noise[number]
    if not has_run_spectrum(recording, noise):
        return None
    space, p = fit_column_space(fit), len(recording.channels)
    start = sum(n.whitener.rows for n in fit.noise[:number])
    part = slice(start, start + noise.whitener.rows)
    taken = (lines(space.basis_in(part), p) ** 2).sum(axis=2)
    return WhitenedSpectrum.of(space.residual[part], taken)
