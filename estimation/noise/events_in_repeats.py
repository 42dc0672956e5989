"""Transient events in a recording with repeats: intervals where one repeat deviates from the others.

Generalised least squares over candidate windows, Bonferroni-corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import chi2_isf
from estimation.noise.power_spectrum import PowerSpectrum, leakage_free, line_powers, smooth_power_spectra, transients
from estimation.noise.recording_noise import sample_step
from estimation.noise.tones import disturbance_basis, pulses
from estimation.noise.transient_windows import Window, Windows, cumulative_sums, variances_of_sums
from estimation.recordings.recording import Recording
from modeling.significance import LEVELS

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

MAX_EVENTS = 3
"""Of a recording, at most; each is sought beside those before it."""


def find_events_in_repeats(recording: Recording, residual: Array) -> tuple[tuple[float, float], ...]:
    """Intervals (s) in which a repeat deviates from the others by more than noise and drift explain.

    Rectangular pulses over a grid of starts and lengths are fitted one after another, together with drift, by
    generalised least squares at the non-excited lines, Bonferroni-corrected for all windows (1 in 1000). An event must
    be significant without its largest sample too: of an outlier nothing remains, of an event all but that sample in
    white noise and one of its two edges in noise of strong low-frequency power.
    """
    if recording.repeats < 3:
        return ()
    events: list[tuple[float, float]] = []
    weighted = _WeightedResidual(recording, residual)
    for _ in range(MAX_EVENTS):
        window = _most_significant_window(weighted, events)
        if window is None:
            break
        events.append(window)
    return tuple(events)


@dataclass(frozen=True, eq=False)
class _WindowScores:
    """Score tests of rectangular pulses b by generalised least squares, from cumulative sums.

    For channel c with weight W_c = 1/S_c at the non-excited lines and nuisance columns D_c (drift, leakage), the score
    of a pulse is (b' M r)² / (b' M b), M = W - W D (D' W D)^-1 D' W.

    product     (n + 1, p) cumulative sum of M r
    nuisance    (n + 1, p, k) cumulative sum of W D (D' W D)^-1/2
    information (n + 1, p) b' W b of a pulse by its length
    """

    product: Array
    nuisance: Array
    information: Array

    def scores(self, windows: Windows) -> Array:
        """Chi-square of pulses over windows, with as many degrees of freedom as channels."""
        explained = (windows.sums(self.nuisance) ** 2).sum(axis=2)
        information = self.information[windows.last - windows.first]
        return np.asarray(
            (windows.sums(self.product) ** 2 / np.maximum(information - explained, 1e-3 * information)).sum(axis=1)
        )

    def share_without_largest_sample(self, start: int, end: int) -> float:
        """Share of the pulse's product b' M r in its strongest channel without the largest sample."""
        parts = np.diff(self.product[start : end + 1], axis=0)
        channel = int(np.argmax(np.abs(parts.sum(axis=0)) / np.sqrt(self.information[end - start])))
        signed = parts[:, channel] * np.sign(parts[:, channel].sum())
        return float((signed.sum() - signed.max()) / signed.sum())


@dataclass(frozen=True, eq=False)
class _WeightedResidual:
    """A residual (n, p) of repeats, and what its windows are scored by, whatever events are found in it."""

    recording: Recording
    residual: Array

    @cached_property
    def spectra(self) -> tuple[PowerSpectrum, ...]:
        """The channels' power spectra without events."""
        return _event_free_spectra(self.recording, self.residual)

    @cached_property
    def weight(self) -> Array:
        """1 / S (lines, p) at the non-excited lines, else 0."""
        n, index = self.recording.samples, np.arange(self.recording.samples // 2 + 1)
        levels = line_powers(self.spectra, n, self.recording.samples_per_repeat, sample_step(self.recording))
        return np.asarray((index % self.recording.repeats != 0)[:, None] / levels)

    def weighted(self, columns: Array, channel: int) -> Array:
        """Columns (n, k) with each line times a channel's weight."""
        lines = np.fft.rfft(columns, axis=0) * self.weight[:, channel, None]
        return np.asarray(np.fft.irfft(lines, n=len(columns), axis=0))

    @cached_property
    def nuisances(self) -> list[tuple[Array, Array]]:
        """Columns (n, k) of drift and leakage for each channel, and weighted."""
        n, dt = self.recording.samples, sample_step(self.recording)
        drift = disturbance_basis(self.recording, ())
        directions = []
        for c, leakage in enumerate(transients(self.spectra, n, dt)):
            directions.append(self.scaled(np.column_stack([drift, leakage]), c))
        return directions

    def scaled(self, columns: Array, channel: int) -> tuple[Array, Array]:
        """Columns (n, k) with c' W c = 1 for each, and weighted."""
        weighted = self.weighted(columns, channel)
        length = np.sqrt((columns * weighted).sum(axis=0))
        return columns / length, weighted / length

    @cached_property
    def products(self) -> Array:
        """The residual weighted, (n, p)."""
        lines = np.fft.rfft(self.residual, axis=0) * self.weight
        return np.asarray(np.fft.irfft(lines, n=len(self.residual), axis=0))

    @cached_property
    def information(self) -> Array:
        """b' W b (n + 1, p) of a pulse b by its length."""
        variances = variances_of_sums(np.fft.irfft(self.weight, n=len(self.residual), axis=0))
        return np.concatenate([np.zeros((1, variances.shape[1])), variances])

    def window_scores(self, events: Sequence[tuple[float, float]]) -> _WindowScores:
        """The scores of windows beside drift, leakage and the events (s) found before."""
        disturbances = pulses(self.recording, events)
        disturbances = disturbances - self.recording.averaged(disturbances)
        product, nuisance = [], []
        for c, nuisances in enumerate(self.nuisances):
            columns, weighted = (np.hstack(pair) for pair in zip(nuisances, self.scaled(disturbances, c), strict=True))
            values, vectors = np.linalg.eigh(columns.T @ weighted)
            independent = values > 1e-9 * values.max()
            orthonormal = weighted @ (vectors[:, independent] / np.sqrt(values[independent]))
            product.append(self.products[:, c] - orthonormal @ (orthonormal.T @ self.residual[:, c]))
            nuisance.append(cumulative_sums(orthonormal))
        size = max(d.shape[1] for d in nuisance)
        nuisance = [np.pad(d, ((0, 0), (0, size - d.shape[1]))) for d in nuisance]
        sums = cumulative_sums(np.stack(product, axis=1))
        return _WindowScores(sums, np.stack(nuisance, axis=1), self.information)


def _event_free_spectra(recording: Recording, residual: Array) -> tuple[PowerSpectrum, ...]:
    """Spectra from the quieter pairs of repeats: the lower quartile over all pairs of their difference's power.

    An event in one or two repeats leaves enough pairs without it. Mean and variance of the quartile of such dependent
    powers come from simulated white noise.
    """
    repeats, period = recording.repeats, recording.samples_per_repeat
    lines = np.fft.rfft(residual.reshape(repeats, period, -1), axis=1)[:, 1:-1]
    mean, shape = _white_quartile(repeats)
    index, step = np.arange(1, lines.shape[1] + 1), sample_step(recording)

    def smoothed(lines: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        power = _lower_quartile_of_pairs(lines / np.sqrt(period)) / mean
        frequency, lowest = index / (period * step), 1 / (recording.samples * step)
        return smooth_power_spectra(frequency, power, shape=shape, start=lowest, nyquist=nyquist)

    return leakage_free(lines, index, period, period, step, smoothed)[0]


@lru_cache
def _white_quartile(repeats: int) -> tuple[float, float]:
    """Mean of the lower quartile of white noise of unit variance, and the shape of a Gamma variable of its spread."""
    drawn = np.random.default_rng(0).standard_normal((repeats, 4000, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    quartile = _lower_quartile_of_pairs(drawn)
    return float(quartile.mean()), float(quartile.mean() ** 2 / quartile.var())


def _lower_quartile_of_pairs(lines: NDArray[np.complex128]) -> Array:
    """Lower quartile over pairs of repeats (the first axis) of |difference|² / 2."""
    first, second = np.triu_indices(len(lines), 1)
    power = np.sort(np.abs(lines[first] - lines[second]) ** 2 / 2, axis=0)
    return np.asarray(power[(len(first) - 1) // 4])


def _most_significant_window(
    weighted: _WeightedResidual, events: Sequence[tuple[float, float]]
) -> tuple[float, float] | None:
    n, p = weighted.residual.shape
    tests = weighted.window_scores(events)
    lengths = np.unique(np.geomspace(max(8, n // 400), n // 2, 24).astype(int))
    windows = Windows.of_lengths(lengths, n - 1, np.maximum(1, lengths // 8))
    score = tests.scores(windows)
    first, last = _refined_window(tests, windows.best(score), n)
    limit = chi2_isf(LEVELS.transient_in_repeats / len(windows), p)
    if score.max() * tests.share_without_largest_sample(first, last) ** 2 < limit:
        return None
    step = sample_step(weighted.recording)
    return first * step, last * step


def _refined_window(tests: _WindowScores, window: Window, n: int) -> Window:
    """The window moved at both ends, by ever smaller steps, to where its score is largest."""
    step = max(1, (window[1] - window[0]) // 8)
    while True:
        near = Windows.near(window, n, step=step, reach=4, shortest=4)
        best = near.best(tests.scores(near))
        if best == window and step == 1:
            return window
        step = max(1, step // 2) if best == window else step
        window = best
