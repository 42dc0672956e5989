"""The noise of a recording with repeats: what lies between the motion's lines, or differs from run to run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.events import find_events
from estimation.noise import Noise, NoiseSource, repeat_floor, step_of
from estimation.passing import passing_basis
from estimation.recording import Recording
from estimation.seam import seamless
from estimation.spectrum import Spectrum, smooth_spectrum
from estimation.tones import find_tones, sinusoids, without
from estimation.whitening import LineWhitener, inverse_root

Array = NDArray[np.float64]

BANDS = 8


def from_repeats(recording: Recording, residual: Array) -> Noise:
    """Noise from the lines between those of the motion, less what passes: drift, warm-up, events and tones.

    Taking columns Q (orthonormal) out of noise of spectrum S leaves S (1 - h) at a line, h = sum |Q's line|² / n;
    the ordinates are divided by that, and lines of which less than half is left are not used. The
    loudest tone stays on the lines between, where an effect may be its name; all others, and on the motion's lines that
    one too, are taken out of every row.
    """
    if not recording.continuous:
        return _from_separate_runs(recording, residual)
    tones = find_tones(recording, residual)
    events = find_events(recording, without(residual, recording, tones))
    n, repeats = len(residual), recording.repeats
    passing = passing_basis(recording, events, tones)
    left = residual - passing @ (passing.T @ residual)
    kept = 1 - (np.abs(np.fft.rfft(passing, axis=0)) ** 2).sum(axis=1) / n
    lines = np.fft.rfft(left, axis=0)
    index = np.arange(len(lines))
    usable = (index % repeats != 0) & (kept > 0.5) & (2 * index != n)
    between = index[usable]
    lines = lines / np.sqrt(np.maximum(kept, 0.5))[:, None]
    frequency, lowest = between / (n * step_of(recording)), 1 / (n * step_of(recording))
    spectra = tuple(smooth_spectrum(frequency, np.abs(column) ** 2 / n, start=lowest) for column in lines[usable].T)
    quiet = ~np.any([s.tones for s in spectra], axis=0)
    loud = np.zeros(len(index), dtype=bool)
    loud[between[~quiet]] = True
    motion = index[(index % repeats == 0) & ~(np.roll(loud, 1) & np.roll(loud, -1))]
    rest = index[(index % repeats != 0) & ~loud]
    order = np.concatenate([motion, rest])
    ordered = np.maximum(order, 1) / (n * step_of(recording))
    levels = np.stack([s(ordered) for s in spectra], axis=1)
    white = lines[between[quiet]] / np.sqrt(n * np.stack([s(frequency[quiet]) for s in spectra], axis=1))
    root = _coherence_roots(between[quiet], white, order) / np.sqrt(levels)[:, None, :]
    freedom = sum(s.freedom for s in spectra) / len(spectra) / len(between)
    plain = LineWhitener(n, repeats, motion, rest, root * np.sqrt(1 - min(freedom, 0.5)))
    waves = [_in_each_channel(sinusoids(recording, [tone]), residual.shape[1]) for tone in tones]
    hidden = np.concatenate(waves, axis=2) if waves else None
    whitener = seamless(plain, spectra, step_of(recording), hidden, judged=waves[0].shape[2] if waves else 0)
    doubt = _doubt(spectra, ordered)
    return Noise(repeat_floor(recording), whitener, NoiseSource.REPEATS, doubt, spectra, events, ordered, tones)


def _in_each_channel(waves: Array, channels: int) -> Array:
    """Series (n, k) as readings (n, p, k p) of one channel each."""
    return np.concatenate([np.multiply.outer(waves, row).swapaxes(1, 2) for row in np.eye(channels)], axis=2)


def _doubt(spectra: tuple[Spectrum, ...], frequency: Array) -> Array:
    """Doubt of each row of a line whitener: two rows per line and channel, real parts first."""
    doubt = np.stack([s.doubt(frequency) for s in spectra], axis=1)
    return np.concatenate([doubt, doubt], axis=1).ravel()


def _from_separate_runs(recording: Recording, residual: Array) -> Noise:
    """Runs that were started one by one: lines of one run, their mean's noise from the differences between runs."""
    repeats, once = recording.repeats, recording.samples_per_repeat
    lines = np.fft.rfft(residual.reshape(repeats, once, -1), axis=1)
    differences = lines - lines.mean(0)
    motion = np.arange(lines.shape[1])
    inner = motion[1:-1]
    frequency = np.maximum(motion, 0.5) / (once * step_of(recording))
    power = (np.abs(differences) ** 2).sum(0) / ((repeats - 1) * once)
    spectra = tuple(
        smooth_spectrum(frequency[inner], c, shape=repeats - 1.0, start=float(frequency[0])) for c in power[inner].T
    )
    quiet = np.ones(len(motion), dtype=bool)
    quiet[inner] = ~np.any([s.tones for s in spectra], axis=0)
    levels = np.stack([s(frequency) for s in spectra], axis=1)
    white = differences / np.sqrt(once * levels) * np.sqrt(repeats / (repeats - 1))
    kept = quiet & (motion > 0)
    index = np.tile(motion[kept], repeats)
    root = _coherence_roots(index, white[:, kept].reshape(len(index), -1), motion[quiet])
    root = root / np.sqrt(levels[quiet])[:, None, :]
    plain = LineWhitener(once * repeats, repeats, motion[quiet] * repeats, np.zeros(0, dtype=np.intp), root)
    whitener = seamless(plain, spectra, step_of(recording))
    doubt, own = _doubt(spectra, frequency[quiet]), frequency[quiet]
    return Noise(repeat_floor(recording), whitener, NoiseSource.REPEATS, doubt, spectra, frequency=own)


def _coherence_roots(
    index: NDArray[np.intp], white: NDArray[np.complex128], at: NDArray[np.intp]
) -> NDArray[np.complex128]:
    """Inverse roots (lines, p, p) of the channels' coherence at the lines `at`.

    The coherence is averaged over bands of equally many lines and taken constant in each. An inverse of an average
    of n products is too large by n / (n - p); the root carries the correction.
    """
    p = white.shape[1]
    order = np.argsort(index, kind="stable")
    bands = max(1, min(BANDS, len(index) // 200))
    edges = [index[part[0]] for part in np.array_split(order, bands)]
    roots = []
    for part in np.array_split(order, bands):
        rows = white[part]
        matrix = rows.T @ rows.conj() / len(rows)
        scale = np.sqrt(np.real(np.diag(matrix)))
        matrix = matrix / np.outer(scale, scale)
        roots.append(inverse_root(matrix) * np.sqrt((len(rows) - p) / len(rows)))
    return np.stack(roots)[np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bands - 1)]
