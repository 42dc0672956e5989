"""Noise spectra from the non-excited lines of a periodic recording, or from the differences between separate runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.noise.disturbances.disturbance_basis import disturbance_basis
from estimation.noise.disturbances.events_in_repeats import find_events_in_repeats
from estimation.noise.disturbances.tones import find_tones, sinusoids, without_sinusoids
from estimation.noise.leakage import LEAST_REMAINING, leakage_free, line_powers, without_leakage
from estimation.noise.power_spectrum import PowerSpectrum, log_power_variances, power_levels, smooth_power_spectra
from estimation.noise.recording_noise import NoiseSource, RecordingNoise, repeat_noise_floor, sample_step
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.recording import Recording
from modeling.noise.channel_whitening import inverse_cholesky_factor

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

COHERENCE_BANDS = 8
"""Frequency bands in each of which the channels' coherence is taken constant, at the most."""


def noise_from_repeats(recording: Recording, residual: Array) -> RecordingNoise:
    """Noise from what differs between the repeats of a residual (n, p), less recording-specific disturbances.

    Where the residual is that of each repeat's own motion, so is the noise.
    """
    from_lines = _from_non_excited_lines if recording.continuous else _from_separate_runs
    found = from_lines(recording, residual)
    return found if recording.own_motion is None else replace(found, floor=repeat_noise_floor(recording, residual))


def _from_non_excited_lines(recording: Recording, residual: Array) -> RecordingNoise:
    """Noise from the non-excited lines, less recording-specific disturbances: drift, warm-up, events and tones.

    Projecting orthonormal columns Q out of noise of spectrum S leaves S (1 - h) at a line, h = sum |Q's line|² / n;
    the ordinates are divided by that, and lines with h above one half are not used. The strongest tone stays on the
    non-excited lines, where an effect may explain it; from the excited lines it is projected out, and all other tones
    from every row.
    """
    tones = find_tones(recording, residual)
    events = find_events_in_repeats(recording, without_sinusoids(residual, recording, tones))
    n, repeats = len(residual), recording.repeats
    disturbances = disturbance_basis(recording, events, tones)
    smooth = disturbances if not events else disturbance_basis(recording, (), tones)
    removed, removed_by_smooth = (_share_of_lines(basis) for basis in (disturbances, smooth))
    lines = np.fft.rfft(residual - disturbances @ (disturbances.T @ residual), axis=0)
    index = np.arange(len(lines))
    usable = (index % repeats != 0) & (1 - removed > LEAST_REMAINING) & (2 * index != n)
    non_excited, lines = index[usable], lines[usable]
    frequency, lowest = non_excited / (n * sample_step(recording)), 1 / (n * sample_step(recording))

    def smoothed(lines: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        return smooth_power_spectra(frequency, np.abs(lines) ** 2 / n, start=lowest, nyquist=nyquist)

    spectra, lines = leakage_free(
        lines / np.sqrt(1 - (removed - removed_by_smooth)[usable])[:, None],
        non_excited,
        n,
        recording.samples_per_repeat,
        sample_step(recording),
        smoothed,
        start=lines / np.sqrt(1 - removed[usable])[:, None],
        disturbances=np.fft.rfft(smooth, axis=0)[usable],
    )
    tone_free = ~np.any([s.tones for s in spectra], axis=0)
    tonal = np.zeros(len(index), dtype=bool)
    tonal[non_excited[~tone_free]] = True
    excited = index[(index % repeats == 0) & ~(np.roll(tonal, 1) & np.roll(tonal, -1))]
    others = index[(index % repeats != 0) & ~tonal]
    order = np.concatenate([excited, others])
    ordered = np.maximum(order, 1) / (n * sample_step(recording))
    levels = line_powers(spectra, n, recording.samples_per_repeat, sample_step(recording))[order]
    white = lines[tone_free] / np.sqrt(n * power_levels(spectra, frequency[tone_free]))
    root = _coherence_roots(non_excited[tone_free], white, order) / np.sqrt(levels)[:, None, :]
    freedom = sum(s.freedom for s in spectra) / len(spectra) / len(non_excited)
    plain = FourierLineWhitener(n, repeats, excited, others, root * np.sqrt(1 - min(freedom, 0.5)))
    return _recording_noise(recording, plain, spectra, ordered, events, tones)


def _share_of_lines(basis: Array) -> Array:
    """Share (n // 2 + 1,) of the power of white noise at each line that is in an orthonormal basis (n, k)."""
    return np.asarray((np.abs(np.fft.rfft(basis, axis=0)) ** 2).sum(axis=1) / len(basis))


def _recording_noise(
    recording: Recording,
    plain: FourierLineWhitener,
    spectra: tuple[PowerSpectrum, ...],
    frequency: Array,
    events: tuple[tuple[float, float], ...] = (),
    tones: tuple[float, ...] = (),
) -> RecordingNoise:
    """The noise with leakage and tones projected out; each line has two rows per channel, real parts first."""
    waves = [_in_each_channel(sinusoids(recording, [tone]), len(spectra)) for tone in tones]
    projected, judged = (np.concatenate(waves, axis=2), waves[0].shape[2]) if waves else (None, 0)
    whitener = without_leakage(plain, spectra, sample_step(recording), projected, judged=judged)
    variance = log_power_variances(spectra, frequency)
    return RecordingNoise(
        floor=repeat_noise_floor(recording),
        whitener=whitener,
        source=NoiseSource.REPEATS,
        log_power_variance=np.concatenate([variance, variance], axis=1).ravel(),
        spectra=spectra,
        events=events,
        frequency=frequency,
        tones=tones,
    )


def _in_each_channel(waves: Array, channels: int) -> Array:
    """Series (n, k) as readings (n, p, k p) of one channel each."""
    return np.concatenate([np.multiply.outer(waves, row).swapaxes(1, 2) for row in np.eye(channels)], axis=2)


def _from_separate_runs(recording: Recording, residual: Array) -> RecordingNoise:
    """Runs that were started one by one: Fourier lines of one run, the noise from the differences between runs."""
    repeats, period = recording.repeats, recording.samples_per_repeat
    lines = np.fft.rfft(residual.reshape(repeats, period, -1), axis=1)
    differences = lines - lines.mean(0)
    excited = np.arange(lines.shape[1])
    inner = excited[1:-1]
    frequency = np.maximum(excited, 0.5) / (period * sample_step(recording))

    def smoothed(differences: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        power, lowest = (np.abs(differences) ** 2).sum(0) / ((repeats - 1) * period), float(frequency[0])
        return smooth_power_spectra(frequency[inner], power, shape=repeats - 1.0, start=lowest, nyquist=nyquist)

    spectra, differences[:, inner] = leakage_free(
        differences[:, inner], inner, period, period, sample_step(recording), smoothed
    )
    tone_free = np.ones(len(excited), dtype=bool)
    tone_free[inner] = ~np.any([s.tones for s in spectra], axis=0)
    levels = line_powers(spectra, period, period, sample_step(recording))
    white = differences / np.sqrt(period * levels) * np.sqrt(repeats / (repeats - 1))
    used = tone_free & (excited > 0)
    index = np.tile(excited[used], repeats)
    root = _coherence_roots(index, white[:, used].reshape(len(index), -1), excited[tone_free])
    root = root / np.sqrt(levels[tone_free])[:, None, :]
    plain = FourierLineWhitener(
        period * repeats, repeats, excited[tone_free] * repeats, np.zeros(0, dtype=np.intp), root
    )
    return _recording_noise(recording, plain, spectra, frequency[tone_free])


def _coherence_roots(
    index: NDArray[np.intp], white: NDArray[np.complex128], at: NDArray[np.intp]
) -> NDArray[np.complex128]:
    """Inverse roots (lines, p, p) of the channels' coherence at the lines `at`.

    The coherence is averaged over bands of equally many lines and taken constant in each. An inverse of an average
    of n products is too large by n / (n - p); the root carries the correction.
    """
    p = white.shape[1]
    order = np.argsort(index, kind="stable")
    bands = max(1, min(COHERENCE_BANDS, len(index) // 200))
    edges = [index[part[0]] for part in np.array_split(order, bands)]
    roots = []
    for part in np.array_split(order, bands):
        rows = white[part]
        matrix = rows.T @ rows.conj() / len(rows)
        scale = np.sqrt(np.real(np.diag(matrix)))
        matrix = matrix / np.outer(scale, scale)
        roots.append(inverse_cholesky_factor(matrix) * np.sqrt((len(rows) - p) / len(rows)))
    return np.stack(roots)[np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bands - 1)]
