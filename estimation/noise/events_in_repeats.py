"""Intervals where one repeat is not as the others: events, in which it deviates, and stretches of larger noise.

Generalised least squares over candidate windows, and the mean power within them, both Bonferroni-corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import chi2_isf, normal_isf
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


ROUGH = 3
"""Order of the differences that show noise alone: of a push, or of how a tool moves, next to nothing is left."""
ROUGHER = 1.5
"""Ratio of their scatter within a window to the usual one, from which a pulse there is judged in that noise."""


def find_events_in_repeats(recording: Recording, residual: Array) -> tuple[tuple[float, float], ...]:
    """Intervals (s) in which a repeat deviates from the others by more than noise and drift explain.

    Rectangular pulses over a grid of starts and lengths are fitted one after another, together with drift, by
    generalised least squares at the non-excited lines, Bonferroni-corrected for all windows (1 in 1000). An event must
    be significant without its largest sample too: of an outlier nothing remains, of an event all but that sample in
    white noise and one of its two edges in noise of strong low-frequency power. Of two repeats nothing tells which one
    deviates: an event is in either.
    """
    if not recording.continuous or recording.repeats < 2:
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
        return np.asarray(self.of_channels(windows).sum(axis=1))

    def of_channels(self, windows: Windows) -> Array:
        """That of each channel, (w, p)."""
        explained = (windows.sums(self.nuisance) ** 2).sum(axis=2)
        information = self.information[windows.last - windows.first]
        return np.asarray(windows.sums(self.product) ** 2 / np.maximum(information - explained, 1e-3 * information))

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

    def local_power(self, first: int, last: int) -> Array:
        """Power (p,) of what is rough within a window, over the usual one: of a push 1, of a burst of noise more."""
        rough = np.abs(np.diff(self.residual - self.recording.averaged(self.residual), n=ROUGH, axis=0))
        if last - first < 2 * EDGES:
            return np.ones(rough.shape[1])
        usual = np.median(rough, axis=0) / normal_isf(0.25)
        ratio = _scatter(rough[max(first - 1, 0) : last]) / np.where(usual > 0, usual, np.inf)
        return np.where(ratio > ROUGHER, ratio, 1.0) ** 2

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


ENOUGH = 4
"""Repeats, from which most pairs are without an event of one of them; of fewer, pieces are compared."""
PIECES, LEAST_PIECE = 4, 60
"""Pieces, and their samples at the least, of each of few repeats: an event is in some of them."""


def _event_free_spectra(recording: Recording, residual: Array) -> tuple[PowerSpectrum, ...]:
    """Spectra from the quieter pairs of repeats: the lower quartile over all pairs of their difference's power.

    An event in one or two repeats leaves enough pairs without it, or in few repeats pairs of their pieces. Mean and
    variance of the quartile of such dependent powers come from simulated white noise.
    """
    repeats, step = recording.repeats, sample_step(recording)
    pieces = 1 if repeats >= ENOUGH or recording.samples_per_repeat < PIECES * LEAST_PIECE else PIECES
    length = recording.samples_per_repeat // pieces
    cut = residual.reshape(repeats, recording.samples_per_repeat, -1)[:, : pieces * length]
    lines = np.fft.rfft(cut.reshape(repeats, pieces, length, -1), axis=2)[:, :, 1:-1]
    mean, shape = _white_quartile(repeats, pieces)
    index = np.arange(1, lines.shape[2] + 1)

    def smoothed(lines: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
        power = _lower_quartile_of_pairs(lines / np.sqrt(length)) / mean
        frequency, lowest = index / (length * step), 1 / (recording.samples * step)
        return smooth_power_spectra(frequency, power, shape=shape, start=lowest, nyquist=nyquist)

    return leakage_free(lines, index, length, length, step, smoothed)[0]


@lru_cache
def _white_quartile(repeats: int, pieces: int) -> tuple[float, float]:
    """Mean of the lower quartile of white noise of unit variance, and the shape of a Gamma variable of its spread."""
    drawn = np.random.default_rng(0).standard_normal((repeats, pieces, 4000, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    quartile = _lower_quartile_of_pairs(drawn)
    return float(quartile.mean()), float(quartile.mean() ** 2 / quartile.var())


def _lower_quartile_of_pairs(lines: NDArray[np.complex128]) -> Array:
    """Lower quartile over pairs of repeats (the first axis), and their pieces (the second), of |difference|² / 2."""
    first, second = np.triu_indices(len(lines), 1)
    power = np.sort((np.abs(lines[first] - lines[second]) ** 2 / 2).reshape(-1, *lines.shape[2:]), axis=0)
    return np.asarray(power[(len(power) - 1) // 4])


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
    share = tests.share_without_largest_sample(first, last) ** 2
    if score.max() * share < limit:
        return None
    (of_channels,) = tests.of_channels(Windows(np.array([first]), np.array([last])))
    if (of_channels / weighted.local_power(first, last)).sum() * share < limit:
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


def find_stretches_in_repeats(recording: Recording, residual: Array) -> tuple[tuple[float, float], ...]:
    """Intervals (s) in which what a repeat deviates by from the others is far larger than noise, whatever its shape.

    Such as an oscillation, of which no pulse explains much. Of repeats without pauses, three at least.
    """
    if recording.repeats < 3 or not recording.continuous:
        return ()
    drift, weight = disturbance_basis(recording, ()), _WeightedResidual(recording, residual).weight
    lines = np.fft.rfft(residual - drift @ (drift.T @ residual), axis=0) * np.sqrt(weight)
    white = np.fft.irfft(lines, n=len(residual), axis=0)
    ratio = scatter_ratio(white.reshape(recording.repeats, recording.samples_per_repeat, -1))
    step = sample_step(recording)
    return tuple((first * step, last * step) for first, last in runs_of(np.any(ratio > 1, axis=1)))


def runs_of(mask: NDArray[np.bool_]) -> list[Window]:
    """First and last + 1 of the stretches in which a mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


# Stretches of larger noise: the scatter about zero of a series, such as third differences or whitened deviations.

BLOCK, MOST_BLOCKS = 8, 1000
"""Samples whose mean power is a datum of the search, at least, and of how many such data it is at the most."""
LARGEST_POWER = 6.0
"""Of a sample over the usual one: what is more counts as this, so that a step or a spike is no noise."""
EDGES = 8
"""Samples, the largest of a stretch, that its scatter is taken without: a step reaches four third differences, a push
has two."""
NOISIER = 2.0
"""Ratio of the scatter of a stretch to that of the other repeats then, from which it counts: a smaller one makes the
std of an estimate wrong by a few percent."""
OF_ONE = 1.5
"""Times that ratio, from which it counts in one channel alone."""
MOST_STRETCHES = 16
"""Of a recording: one with more of them is noisy as a whole."""


ROUNDS = 3
"""Searches that follow each other: of two stretches that touch, the noisier one is still so when both weigh less."""


def scatter_ratio(series: Array) -> Array:
    """Scatter (n, p) of each repeat of a series (repeats, m, p) of zero mean over that of the others, 1 where it is as
    usual; in stretches, each of one ratio or of several that follow each other."""
    ratio = np.ones_like(series)
    for _ in range(ROUNDS):
        more = _noisy_stretches(series / ratio)
        for first, last, times in more:
            ratio.reshape(-1, series.shape[2])[first:last] *= times
        if not more:
            break
    return ratio.reshape(-1, series.shape[2])


def _noisy_stretches(series: Array) -> list[tuple[int, int, Array]]:
    """Samples first <= t < last of a series (repeats, m, p) in which a repeat scatters more than it does elsewhere.

    With the ratios (p,) of that scatter. And more than the others at the same place of the motion: noise that grows
    with the speed is that of all repeats. Windows of blocks are tested by their mean power, of each channel and of all,
    in the spread that blocks have. None if there were more than `MOST_STRETCHES`.
    """
    repeats, m, p = series.shape
    size = np.abs(series).reshape(-1, p)
    usual = np.median(size, axis=0) / normal_isf(0.25)
    size, usual = size[:, usual > 0], usual[usual > 0]
    block = max(BLOCK, len(size) // MOST_BLOCKS)
    count = len(size) // block
    if not len(usual) or count < 4 * repeats:
        return []
    power = np.minimum((size / usual) ** 2, LARGEST_POWER)[: count * block].reshape(count, block, -1).mean(axis=1)
    power = np.column_stack([power, power.mean(axis=1)])
    centre = np.median(power, axis=0)
    spread = np.median(np.abs(power - centre), axis=0) / normal_isf(0.25)
    quiet = np.where(np.abs(power - centre) < 3 * spread, power - centre, 0.0)
    correlation = np.clip((quiet[1:] * quiet[:-1]).sum(axis=0) / (quiet**2).sum(axis=0), 0.0, 0.9)
    freedom = 2 * (centre / spread) ** 2 * (1 - correlation) / (1 + correlation)  # of a block
    windows = Windows.of_lengths(np.unique(np.geomspace(2, count // 3, 20).astype(int)), count)
    length = (windows.last - windows.first)[:, None]
    variance = 2 / (9 * freedom * length)  # of the cube root of a chi-square, which is nearly normal
    mean = windows.sums(cumulative_sums(power)) / length / centre
    score = np.max((np.cbrt(mean) - 1 + variance) / np.sqrt(variance), axis=1)
    limit = float(normal_isf(LEVELS.transient_in_repeats / (len(windows) * power.shape[1])))
    stretches: list[tuple[int, int, Array]] = []

    def ratio_within(first: int, last: int) -> Array:
        rows = np.arange(first, last)
        within, *others = (_scatter(size[(rows + shift * m) % len(size)]) for shift in range(repeats))
        beside = np.sort(others, axis=0)[(repeats - 2) // 4]  # the lower quartile, as others may be noisy there, too
        return np.asarray(within / np.maximum(beside, usual))

    for number in windows.best_disjoint(np.where(score > limit, score**2 - limit**2, 0.0)):
        first, last = int(windows.first[number]) * block, int(windows.last[number]) * block
        ratio = ratio_within(first, last)
        if max(float(np.exp(np.mean(np.log(ratio)))), float(ratio.max()) / OF_ONE) < NOISIER:
            continue
        std = np.maximum(ratio, 1.0)
        gain = cumulative_sums(np.sum((size / usual) ** 2 * (1 - std**-2) / 2 - np.log(std), axis=1))
        before, middle = max(first - block, stretches[-1][1] if stretches else 0), (first + last) // 2
        first = before + int(np.argmin(gain[before : max(middle, before + 1)]))
        last = middle + int(np.argmax(gain[middle : last + block + 1]))
        if last - first > 2 * EDGES:
            std = np.maximum(ratio_within(first, last), 1.0)
        every = np.ones(p)
        every[np.median(np.abs(series), axis=(0, 1)) > 0] = std
        stretches.append((first, last, every))
    return stretches if len(stretches) <= MOST_STRETCHES else []


def _scatter(size: Array) -> Array:
    """Std (p,) of a stretch by a quantile of its absolute values (n, p), whatever the `EDGES` largest of them are."""
    place = (len(size) - EDGES) // 2
    return np.asarray(np.partition(size, place, axis=0)[place] / normal_isf(0.5 - (place + 0.5) / (2 * len(size))))
