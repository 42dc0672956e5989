"""The noise of a recording: its floor per channel, where that is known from, and how to whiten with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from estimation.recording import Recording
from estimation.spectrum import Spectrum, smooth_spectrum
from estimation.whitening import LineWhitener, RegressionWhitener, Whitener, inverse_root
from modeling.errors import InputError

Array = NDArray[np.float64]

DRIFT_DEGREE = 8
"""Degree of the polynomials that are taken for drift, not noise: four half-waves over the record to 0.1 % of power."""
SEAM = 4
"""Samples after the record's end is joined to its start at which coloured noise may start anew."""
MOST_EVENTS = 3
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
    frequency Hz of each line of a line whitener, in its order
    """

    floor: Array
    whitener: Whitener
    source: NoiseSource
    doubt: Array
    spectra: tuple[Spectrum, ...] = ()
    events: tuple[tuple[float, float], ...] = ()
    frequency: Array = field(default_factory=lambda: np.zeros(0))

    def doubt_of(self, shares: Array) -> Array:
        """Variance (g,) of the logarithm of sums of squared rows, whose parts come from each row by `shares` (rows, g).

        To first order the logarithm of such a sum moves by the shares times the logarithms of the noise's power. Those
        belong together along a channel's curve and not from channel to channel.
        """
        if len(self.doubt) != 2 * len(self.frequency) * len(self.spectra) or not self.spectra:
            return np.asarray(self.doubt @ shares)
        lines = shares.reshape(len(self.frequency), 2, len(self.spectra), -1).sum(axis=1)
        return np.asarray(sum(s.joint_doubt(self.frequency, lines[:, c]) for c, s in enumerate(self.spectra)))


def noise_of(
    recording: Recording, residual: Array, fitted: int = 0, events: tuple[tuple[float, float], ...] = ()
) -> Noise:
    """Noise of a recording from the residual (n, p) of any model of what repeats.

    With repeats the residual's periodic part does not matter: the spectrum comes from the lines between those of
    the motion (or from differences of separate runs). Without, it is the std that the rig states per
    channel if it does, else an autoregression fitted to the residual, which then cannot judge that residual's size;
    `fitted` is the number of parameters that went into it, `events` are intervals (s) of a run with noise of their own.
    """
    if recording.repeats > 1:
        _require_noise(recording)
        return _from_repeats(recording, residual)
    stated = stated_floor(recording)
    if stated is not None:
        whitener = RegressionWhitener(len(residual), 1, np.zeros((0, len(stated))), np.diag(1 / stated))
        return Noise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events)
    from estimation.residual_noise import from_residual

    return from_residual(recording, residual, fitted, events)


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


def _require_noise(recording: Recording) -> None:
    """Raise InputError for channels that read the same in every repeat."""
    largest = np.abs(recording.wrench).max(axis=0)
    floor = repeat_floor(recording)
    dead = [c for c, f, size in zip(recording.channels, floor, largest, strict=True) if f <= 1e-9 * size or size == 0]
    if dead:
        raise InputError(
            what=f"{', '.join(dead)} reads the same in every repeat, so that no noise can be measured",
            where=recording.name,
            remedy="record the raw sensor, or leave `repeat` out and state the noise under [sensor] in the rig",
        )


def _from_repeats(recording: Recording, residual: Array) -> Noise:
    """Noise from the lines between those of the motion, less what passes: drift, warm-up and events.

    Taking columns Q (orthonormal) out of noise of spectrum S leaves S (1 - h) at a line, h = sum |Q's line|² / n;
    the ordinates are divided by that, and lines of which less than half is left are not used.
    """
    if not recording.continuous:
        return _from_separate_runs(recording, residual)
    events = find_events(recording, residual)
    n, repeats = len(residual), recording.repeats
    passing = _passing_basis(recording, events)
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
    whitener = _seamless(plain, spectra, step_of(recording))
    doubt = _doubt(spectra, ordered)
    return Noise(repeat_floor(recording), whitener, NoiseSource.REPEATS, doubt, spectra, events, ordered)


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
    whitener = _seamless(plain, spectra, step_of(recording))
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


def _passing_basis(recording: Recording, events: Sequence[tuple[float, float]]) -> Array:
    """What drifts, follows an auxiliary signal or belongs to an event, less what repeats: orthonormal (n, k)."""
    n, repeats = recording.samples, recording.repeats
    columns = list(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), DRIFT_DEGREE)[:, 1:].T)
    columns += [recording.signals[name] for name in recording.auxiliary]
    time = np.arange(n) * step_of(recording)
    columns += [((time >= start) & (time < end)).astype(float) for start, end in events]
    blocks = np.stack(columns, axis=1).reshape(repeats, n // repeats, -1)
    changing = (blocks - blocks.mean(axis=0)).reshape(n, -1)
    scale = np.linalg.norm(changing, axis=0)
    changing = changing[:, scale > 1e-12 * max(scale.max(), 1e-300)]
    left, singular, _ = np.linalg.svd(changing / np.linalg.norm(changing, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])


@dataclass(frozen=True, eq=False)
class SeamlessWhitener(LineWhitener):
    """A line whitener that does not believe the seam, where the transform joins the record's end to its start.

    Coloured noise does not close on itself. Filtered to whiteness round the seam, the first few samples after it are
    wrong, by the same amount in all lines: to a drift, which jumps there too, they look like proof. The noise is
    therefore free to start anew, as in an autoregression that is given its first samples. The directions `seam`
    (rows, k), orthonormal, of the motion's lines and of those between are taken out of every row, and the rest
    scaled so that the squares of noise still add up to the number of rows.
    """

    steady_seam: Array
    rest_seam: Array

    def series(self, values: Array) -> Array:
        """Rows of a series over the whole record, without the seam."""
        rows = super().series(values)
        parts = (
            _without(rows[: self.steady_rows], self.steady_seam),
            _without(rows[self.steady_rows :], self.rest_seam),
        )
        return np.concatenate(parts)

    def steady(self, values: Array) -> Array:
        """Rows of one repeat of a periodic series, without the seam."""
        return _without(super().steady(values), self.steady_seam)


def _without(rows: Array, seam: Array) -> Array:
    if not rows.size or not seam.size:
        return rows
    flat = rows.reshape(len(rows), -1)
    kept = flat - seam @ (seam.T @ flat)
    return np.asarray(kept * np.sqrt(len(rows) / (len(rows) - seam.shape[1]))).reshape(rows.shape)


def _seamless(plain: LineWhitener, spectra: tuple[Spectrum, ...], dt: float) -> LineWhitener:
    """The whitener less the noise that begins at the seam: its answer to each of the first shocks."""
    once = plain.samples // plain.repeats
    steady = plain.steady(_shocks(spectra, once, dt))
    rest = np.zeros((0, 1))
    if len(plain.between):
        rest = plain.series(_shocks(spectra, plain.samples, dt))[plain.steady_rows :]
    fields = (plain.samples, plain.repeats, plain.motion, plain.between, plain.root)
    return SeamlessWhitener(*fields, np.linalg.qr(steady)[0], np.linalg.qr(rest)[0])


def _shocks(spectra: tuple[Spectrum, ...], n: int, dt: float) -> Array:
    """Noise (n, p, p SEAM) that a unit shock in one channel at one of the first samples sets going.

    The causal series whose transform has the modulus sqrt(S): the minimum-phase one, by folding the cepstrum.
    """
    p = len(spectra)
    series = np.zeros((n, p, p * SEAM))
    frequency = np.maximum(np.arange(n // 2 + 1), 1) / (n * dt)
    for channel, spectrum in enumerate(spectra):
        cepstrum = np.fft.irfft(np.log(spectrum(frequency)) / 2, n=n)
        cepstrum[1 : (n + 1) // 2] *= 2
        cepstrum[n // 2 + 1 :] = 0
        answer = np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), n=n)
        for late in range(SEAM):
            series[:, channel, channel * SEAM + late] = np.roll(answer, late)
    return series


# ------------------------------------------------------------------------------------------- events


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
    passing = _passing_basis(recording, found)
    index = np.arange(n // 2 + 1)
    spectra = _undisturbed_spectra(recording, residual)
    frequency = np.maximum(index, 1) / (n * dt)
    weight = (index % repeats != 0)[:, None] / np.stack([s(frequency) for s in spectra], axis=1)
    shocks = _shocks(spectra, n, dt)
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
    limit = chi2.isf(0.001 / len(start), p)
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
