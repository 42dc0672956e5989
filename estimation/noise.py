"""The noise of a recording: its floor per channel, where that is known from, and how to whiten with it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimation.recording import Recording
from estimation.spectrum import Spectrum, smooth_spectrum
from estimation.whitening import LineWhitener, RegressionWhitener, Whitener, inverse_root

Array = NDArray[np.float64]

DRIFT_DEGREE = 4
BANDS = 8


class NoiseSource(Enum):
    """What the noise is known from."""

    REPEATS = "repeats"
    RIG = "rig"
    RESIDUAL = "residual"


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of one recording.

    floor     std of one sample per channel, in its unit
    whitener  the map to rows of unit variance
    source    what it was estimated from
    doubt     per whitened row, the variance of the logarithm of the noise power it was divided by
    spectra   per channel the power spectrum per line (repeats only), S of one sample: white noise has S = std²
    events    intervals (s) found to differ from the other repeats, left out of the spectrum
    """

    floor: Array
    whitener: Whitener
    source: NoiseSource
    doubt: Array
    spectra: tuple[Spectrum, ...] = ()
    events: tuple[tuple[float, float], ...] = ()


def noise_of(recording: Recording, residual: Array, fitted: int = 0) -> Noise:
    """Noise of a recording from the residual (n, p) of any model of what repeats.

    With repeats the residual's periodic part does not matter: the spectrum comes from the lines between those of
    the motion (or from differences of separate runs). Without, it is the std that the rig states per
    channel if it does, else an autoregression fitted to the residual, which then cannot judge that residual's size;
    `fitted` is the number of parameters that went into it.
    """
    if recording.repeats > 1:
        return _from_repeats(recording, residual)
    stated = stated_floor(recording)
    if stated is not None:
        whitener = RegressionWhitener(len(residual), np.zeros((0, len(stated), len(stated))), np.diag(1 / stated))
        return Noise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows))
    return _from_residual(recording, residual, fitted)


def step_of(recording: Recording) -> float:
    """Step of the clock in s; 1 for poses at rest, which have none."""
    return recording.dt if recording.dt is not None else 1.0


def stated_floor(recording: Recording) -> Array | None:
    """Std of one sample per channel (p,) as the rig states it, None when it does not for every channel."""
    stated = recording.rig.sensor.noise if recording.rig is not None else None
    if stated is None or not all(stated.get(channel) for channel in recording.channels):
        return None
    return np.array([stated[channel] for channel in recording.channels])


def repeat_floor(recording: Recording) -> Array:
    """Std of one sample of one repeat about the mean over repeats, (p,), with R - 1 degrees of freedom."""
    repeats, once = recording.repeats, recording.samples_per_repeat
    blocks = recording.wrench.reshape(repeats, once, -1)
    return np.asarray(np.sqrt(((blocks - blocks.mean(0)) ** 2).sum((0, 1)) / (once * (repeats - 1))))


def _from_repeats(recording: Recording, residual: Array) -> Noise:
    if not recording.continuous:
        return _from_separate_runs(recording, residual)
    events = find_events(recording, residual)
    passing = residual - _passing(recording, residual, events)
    n, repeats = len(residual), recording.repeats
    lines = np.fft.rfft(passing, axis=0)
    index = np.arange(len(lines))
    usable = (index % repeats != 0) & (index > DRIFT_DEGREE - 1) & (2 * index != n)
    between = index[usable]
    frequency = between / (n * step_of(recording))
    spectra = tuple(smooth_spectrum(frequency, np.abs(column) ** 2 / n) for column in lines[usable].T)
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
    whitener = LineWhitener(n, repeats, motion, rest, root * np.sqrt(1 - min(freedom, 0.5)))
    return Noise(repeat_floor(recording), whitener, NoiseSource.REPEATS, _doubt(spectra, ordered), spectra, events)


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
    spectra = tuple(smooth_spectrum(frequency[inner], c, shape=repeats - 1.0) for c in power[inner].T)
    quiet = np.ones(len(motion), dtype=bool)
    quiet[inner] = ~np.any([s.tones for s in spectra], axis=0)
    levels = np.stack([s(frequency) for s in spectra], axis=1)
    white = differences / np.sqrt(once * levels) * np.sqrt(repeats / (repeats - 1))
    kept = quiet & (motion > 0)
    index = np.tile(motion[kept], repeats)
    root = _coherence_roots(index, white[:, kept].reshape(len(index), -1), motion[quiet])
    root = root / np.sqrt(levels[quiet])[:, None, :]
    whitener = LineWhitener(once * repeats, repeats, motion[quiet] * repeats, np.zeros(0, dtype=np.intp), root)
    return Noise(repeat_floor(recording), whitener, NoiseSource.REPEATS, _doubt(spectra, frequency[quiet]), spectra)


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


def _passing(recording: Recording, residual: Array, events: tuple[tuple[float, float], ...]) -> Array:
    """What drifts, follows an auxiliary signal or belongs to an event in the residual, by least squares."""
    n, repeats = len(residual), recording.repeats
    progress = np.linspace(-1, 1, n)
    columns = list(np.polynomial.legendre.legvander(progress, DRIFT_DEGREE)[:, 1:].T)
    columns += [recording.signals[name] for name in recording.auxiliary]
    time = np.arange(n) * step_of(recording)
    columns += [((time >= start) & (time <= end)).astype(float) for start, end in events]
    matrix = np.stack(columns, axis=1)
    matrix = matrix - matrix.mean(0)
    scale = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, scale > 1e-12 * max(scale.max(), 1e-300)]

    def changing(series: Array) -> Array:
        blocks = series.reshape(repeats, n // repeats, -1)
        return np.asarray((blocks - blocks.mean(0)).reshape(n, -1))

    solution = np.linalg.lstsq(changing(matrix), changing(residual), rcond=1e-9)[0]
    return np.asarray(matrix @ solution)


def find_events(recording: Recording, residual: Array) -> tuple[tuple[float, float], ...]:
    """Intervals (s) in which one repeat differs from the others more than noise explains.

    The noise is the median over successive repeats' differences, which one event cannot reach; each window's
    whitened mean is compared over a grid of starts and lengths, with all windows paid for (1 in 1000).
    """
    n, repeats = len(residual), recording.repeats
    if repeats < 3:
        return ()
    found: list[tuple[float, float]] = []
    for _ in range(3):
        smooth = residual - _passing(recording, residual, tuple(found))
        blocks = smooth.reshape(repeats, n // repeats, -1)
        different = (blocks - np.median(blocks, axis=0)).reshape(n, -1)
        window = _loudest_window(different, _difference_spectrum(blocks, step_of(recording)), step_of(recording))
        if window is None:
            break
        found.append(window)
    return tuple(found)


def _difference_spectrum(blocks: Array, dt: float) -> tuple[Spectrum, ...]:
    """Spectra from the median over differences of successive repeats."""
    once = blocks.shape[1]
    power = np.abs(np.fft.rfft(np.diff(blocks, axis=0), axis=1)) ** 2 / (2 * once)
    middle = np.median(power, axis=0)[1:-1] / _median_of_exponentials(len(power))
    frequency = np.arange(1, len(middle) + 1) / (once * dt)
    return tuple(smooth_spectrum(frequency, column, shape=max(1.0, 0.5 * len(power))) for column in middle.T)


def _median_of_exponentials(count: int) -> float:
    """Mean of the sample median of `count` unit exponentials, from their order statistics' spacings."""
    below, above = (count + 1) // 2, count // 2 + 1
    return float(np.mean([sum(1 / (count - i) for i in range(rank)) for rank in (below, above)]))


def _loudest_window(series: Array, spectra: tuple[Spectrum, ...], dt: float) -> tuple[float, float] | None:
    from scipy.stats import chi2

    n, p = series.shape
    frequency = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
    frequency[0] = frequency[1]
    levels = np.stack([s(frequency) for s in spectra], axis=1)
    weighted = np.fft.irfft(np.fft.rfft(series, axis=0) / levels, n=n, axis=0)
    total = np.concatenate([np.zeros((1, p)), np.cumsum(weighted, axis=0)])
    lengths = np.unique(np.geomspace(max(8, n // 400), n // 2, 24).astype(int))
    best, trials = (0.0, 0, 0), 0
    for length in lengths:
        starts = np.arange(0, n - length, max(1, length // 8))
        box = np.zeros(n)
        box[:length] = 1
        information = (np.abs(np.fft.rfft(box)) ** 2)[:, None] / levels
        energy = (2 * information.sum(0) - information[0]) / n
        score = ((total[starts + length] - total[starts]) ** 2 / energy).sum(1)
        trials += len(starts)
        if score.max() > best[0]:
            best = (float(score.max()), int(starts[score.argmax()]), int(length))
    if best[0] < chi2.isf(0.001 / trials, p):
        return None
    return best[1] * dt, (best[1] + best[2]) * dt


def _from_residual(recording: Recording, residual: Array, fitted: int) -> Noise:
    """Poses: the spread of each channel's residual. A run: a vector autoregression, its order by Akaike's criterion.

    What is left of poses is more the model's error than noise; taking its correlations between the channels for
    noise would let one channel's error move what another has measured, so that they are left out.
    """
    n, p = residual.shape
    floor = np.sqrt((residual**2).sum(axis=0) / max(1.0, n - fitted / p))
    floor = np.maximum(floor, 1e-12 * max(floor.max(), 1e-300))
    if recording.at_rest:
        coefficients, covariance = np.zeros((0, p, p)), np.diag(floor**2)
    else:
        coefficients, covariance = _best_autoregression(residual)
    whitener = RegressionWhitener(n, coefficients, np.real(inverse_root(covariance)))
    parameters = coefficients.size + p * (p + 1) / 2
    return Noise(floor, whitener, NoiseSource.RESIDUAL, np.full(whitener.rows, 2 * parameters / (n * p)))


def _best_autoregression(residual: Array) -> tuple[Array, Array]:
    n, p = residual.shape
    highest = int(np.clip(n // (20 * p), 0, 60))
    best: tuple[float, Array, Array] | None = None
    for order in (order for order in (0, 1, 2, 4, 8, 15, 30, 60) if order <= highest):
        coefficients, covariance = _autoregression(residual, order)
        criterion = (n - order) * np.linalg.slogdet(covariance)[1] + 2 * order * p * p
        if best is None or criterion < best[0]:
            best = (float(criterion), coefficients, covariance)
    assert best is not None
    return best[1:]


def _autoregression(residual: Array, order: int) -> tuple[Array, Array]:
    n, p = residual.shape
    target = residual[order:]
    if not order:
        coefficients = np.zeros((0, p, p))
        remainder = target
    else:
        past = np.concatenate([residual[order - lag : n - lag] for lag in range(1, order + 1)], axis=1)
        solution = np.linalg.lstsq(past, target, rcond=None)[0]
        coefficients = solution.reshape(order, p, p).transpose(0, 2, 1)
        remainder = target - past @ solution
    covariance = remainder.T @ remainder / max(1, len(remainder) - order * p)
    tiny = 1e-12 * np.eye(p) * max(np.trace(covariance) / p, 1e-300)
    return coefficients, covariance + tiny
