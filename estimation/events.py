"""Events: intervals in which one repeat differs from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_isf
from estimation.noise import step_of
from estimation.passing import passing_basis
from estimation.recording import Recording
from estimation.seam import SEAM, shocks_of
from estimation.spectrum import Spectrum, smooth_spectrum

Array = NDArray[np.float64]

MOST_EVENTS = 3


def find_events(recording: Recording, residual: Array) -> tuple[tuple[float, float], ...]:
    """Intervals (s) in which a push differs from the other repeats more than noise and drift explain.

    Boxes over a grid of starts and lengths are fitted one after another, together with drift, by generalised least
    squares at the lines between those of the motion; all windows are paid for (1 in 1000). A push has to be
    significant without its loudest sample too: of an outlier nothing remains, of a push all but that sample in white
    noise and one of its two edges in noise that wanders.
    """
    if recording.repeats < 3:
        return ()
    found: list[tuple[float, float]] = []
    for _ in range(MOST_EVENTS):
        window = _loudest_window(recording, residual, found)
        if window is None:
            break
        found.append(window)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Windows:
    """Boxes as columns of a generalised least-squares fit, by cumulative sums: for channel c with weight W_c = 1/S_c at
    the lines between, what drifts is D_c, and the score of box b is (b' M r)² / (b' M b), M = W - W D (D' W D)^-1 D' W.

    along    (n + 1, p) cumulative sum of M r
    drift    (n + 1, p, k) of W D (D' W D)^-1/2
    spread   (n + 1, p) b' W b of a box by its length
    """

    along: Array
    drift: Array
    spread: Array

    def scores(self, start: NDArray[np.intp], end: NDArray[np.intp]) -> Array:
        """Chi-square of boxes over samples start <= t < end, with as many degrees of freedom as channels."""
        product = self.along[end] - self.along[start]
        taken = ((self.drift[end] - self.drift[start]) ** 2).sum(axis=2)
        spread = self.spread[end - start]
        return np.asarray((product**2 / np.maximum(spread - taken, 1e-3 * spread)).sum(axis=1))

    def without_loudest(self, start: int, end: int) -> float:
        """Share of the box's product that remains in its strongest channel without its loudest sample."""
        parts = np.diff(self.along[start : end + 1], axis=0)
        channel = int(np.argmax(np.abs(parts.sum(axis=0)) / np.sqrt(self.spread[end - start])))
        own = parts[:, channel] * np.sign(parts[:, channel].sum())
        return float((own.sum() - own.max()) / own.sum())


def _windows(recording: Recording, residual: Array, found: Sequence[tuple[float, float]]) -> _Windows:
    n, repeats, dt = recording.samples, recording.repeats, step_of(recording)
    passing = passing_basis(recording, found)
    index = np.arange(n // 2 + 1)
    spectra = _undisturbed_spectra(recording, residual)
    frequency = np.maximum(index, 1) / (n * dt)
    weight = (index % repeats != 0)[:, None] / np.stack([s(frequency) for s in spectra], axis=1)
    shocks = shocks_of(spectra, n, dt)
    along, drift, spread = [], [], []
    for c in range(len(spectra)):
        own = np.column_stack([passing, shocks[:, c, c * SEAM : (c + 1) * SEAM]])
        own = own / np.linalg.norm(own, axis=0)
        weighted = np.fft.irfft(np.fft.rfft(own, axis=0) * weight[:, c, None], n=n, axis=0)
        values, vectors = np.linalg.eigh(own.T @ weighted)
        shown = values > 1e-9 * values.max()
        turned = weighted @ (vectors[:, shown] / np.sqrt(values[shown]))
        plain = np.fft.irfft(np.fft.rfft(residual[:, c]) * weight[:, c], n=n)
        along.append(plain - turned @ (turned.T @ residual[:, c]))
        drift.append(np.cumsum(np.vstack([np.zeros(turned.shape[1]), turned]), axis=0))
        correlation = np.fft.irfft(weight[:, c], n=n)
        sums = np.cumsum(correlation)
        spread.append(np.concatenate([[0.0], 2 * np.cumsum(sums) - np.arange(1, n + 1) * correlation[0]]))
    size = max(d.shape[1] for d in drift)
    drift = [np.pad(d, ((0, 0), (0, size - d.shape[1]))) for d in drift]
    cumulative = np.cumsum(np.vstack([np.zeros(len(along)), np.stack(along, axis=1)]), axis=0)
    return _Windows(cumulative, np.stack(drift, axis=1), np.stack(spread, axis=1))


def _undisturbed_spectra(recording: Recording, residual: Array) -> tuple[Spectrum, ...]:
    """Spectra from the quieter pairs of repeats: the lower quartile over all pairs of their difference's power.

    A push in one or two repeats leaves enough pairs without it. Mean and spread of the quartile of such dependent
    powers come from draws of white noise.
    """
    repeats, once = recording.repeats, recording.samples_per_repeat
    lines = np.fft.rfft(residual.reshape(repeats, once, -1), axis=1)[:, 1:-1]
    drawn = np.random.default_rng(0).standard_normal((repeats, 4000, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    reference = _quieter_pairs(drawn)
    power = _quieter_pairs(lines / np.sqrt(once)) / reference.mean()
    shape = float(reference.mean() ** 2 / reference.var())
    frequency = np.arange(1, len(power) + 1) / (once * step_of(recording))
    lowest = 1 / (recording.samples * step_of(recording))
    return tuple(smooth_spectrum(frequency, column, shape=shape, start=lowest) for column in power.T)


def _quieter_pairs(lines: NDArray[np.complex128]) -> Array:
    """Lower quartile over pairs of repeats (the first axis) of |difference|² / 2."""
    first, second = np.triu_indices(len(lines), 1)
    power = np.sort(np.abs(lines[first] - lines[second]) ** 2 / 2, axis=0)
    return np.asarray(power[(len(first) - 1) // 4])


def _loudest_window(
    recording: Recording, residual: Array, found: Sequence[tuple[float, float]]
) -> tuple[float, float] | None:
    n, p = residual.shape
    windows = _windows(recording, residual, found)
    lengths = np.unique(np.geomspace(max(8, n // 400), n // 2, 24).astype(int))
    starts = [np.arange(0, n - length, max(1, length // 8)) for length in lengths]
    start = np.concatenate(starts)
    end = start + np.repeat(lengths, [len(s) for s in starts])
    score = windows.scores(start, end)
    best = int(score.argmax())
    limit = chi2_isf(0.001 / len(start), p)
    first, last = _sharpened(windows, int(start[best]), int(end[best]), n)
    if score[best] * windows.without_loudest(first, last) ** 2 < limit:
        return None
    return first * step_of(recording), last * step_of(recording)


def _sharpened(windows: _Windows, start: int, end: int, n: int) -> tuple[int, int]:
    """The window moved at both ends, by ever smaller steps, to where its score is largest."""
    step = max(1, (end - start) // 8)
    while True:
        moves = np.array([(start + i * step, end + j * step) for i in range(-4, 5) for j in range(-4, 5)])
        moves = moves[(moves[:, 0] >= 0) & (moves[:, 1] <= n) & (moves[:, 1] - moves[:, 0] >= 4)]
        best = moves[windows.scores(moves[:, 0], moves[:, 1]).argmax()]
        if (best == (start, end)).all():
            if step == 1:
                return start, end
            step = max(1, step // 2)
        start, end = int(best[0]), int(best[1])
