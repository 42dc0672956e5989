"""Motion of each repeat: whether repeats differ beyond their noise, by how much, and what a prediction makes of it.

The response y of a model to the mean motion m is the same in every repeat, which is what makes screening fast: its
rows are the excited lines alone. Repeat r moved by m + d_r, and the prediction of its readings is

    y_r(theta) = y(m; theta) + [y(m + d_r; theta) - y(m; theta)].

The bracket (`ModelResponse.own_motion`) is evaluated exactly, over the whole record, whenever a prediction is, with the
parameters and effects of that prediction; so noise that is estimated from the residual is what remains between the
repeats after the model has accounted for their motions. Derivatives in the parameters, of a fit and in screening, are
those of y(m; theta): they are wrong by the share epsilon by which the motions differ, and the effect that a score test
misses by epsilon squared. Beyond `GROSS` they are no repeats of one motion: that is
said when they are read, and refused when their noise is asked for.

d_r is measured with noise. It is derived where it is significant, column by column: a line of the spectrum of
x_r - mean(x), of the whole record or of one repeat, exceeds the white noise floor, or the power law, that the upper
three octaves show, by more than chance allows at `LEVELS.repeat_motion`. Slow noise of an encoder looks like motion
even so, but is not in the readings: `readings_follow_repeats` of `estimation/model_response.py` asks them. Where one
says no, d_r is zero, and nothing is evaluated but the mean motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from estimation.recordings.differentiation import line_noise_floor, spline_derivatives
from estimation.recordings.motion_period import motion_components
from modeling.significance import LEVELS

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

SPECTRUM_BANDS = 40
"""Of a spectrum that weighs what differs between repeats, equally wide in the logarithm of the frequency."""
FEWEST_LINES = 4
"""Of a band: the power of a single line may by chance be ten times too low."""
ROUNDING = 1e-10
"""Relative size below which a channel's variation, a variance or a line's power is only rounding."""


def varying_channels(readings: Array) -> NDArray[np.bool_]:
    """Which channels (p,) of readings (n, p) are not constant."""
    return np.asarray(readings.std(axis=0) > ROUNDING * np.abs(readings).max(axis=0))


def is_separated(added: Array, readings: Array, repeats: int) -> bool:
    """Whether differences between repeats of the readings (n, p) surely contain what the motion adds to them (n, p).

    Repeats are compared by orthonormal contrasts of the samples of one phase, of which stationary noise makes runs of
    its own colour, and the mean nothing. An autoregression of these runs whitens them without leakage from their ends,
    and the channels are made uncorrelated by the innovations' covariance; constant channels say nothing, and neither
    does the mean of a run, as the sensor's zero may differ.

    In a band of m lines with the noise power S, unknown, the lines E are normal about zero if the motion was not so,
    and about the lines D of what it adds if it was. With the prior dS / S (right Haar) the likelihoods of the two are
    as (sum |E - D|²)^-m to (sum |E|²)^-m; above 99 to 1 over all bands and channels the second is taken. Whatever D
    is, such a ratio has the mean 1 where E is noise, so that it exceeds 99 at one time in 99 at the most (an e-value;
    P. Grünwald, R. de Heide and W. Koolen, J. R. Stat. Soc. B 86, 2024, 1091-1128).
    """
    varying = varying_channels(readings)
    if not varying.any():
        return False
    contrasts, expected = (_contrasts(series[:, varying], repeats) for series in (readings, added))
    noise = fit_autoregression(contrasts.transpose(0, 2, 1).reshape(-1, contrasts.shape[1]), _with_past(contrasts))
    contrasts, expected = (noise.innovations(runs).transpose(0, 2, 1) for runs in (contrasts, expected))
    decorrelated = _decorrelation(contrasts.reshape(-1, contrasts.shape[2]))
    lines, moved = (_lines(runs @ decorrelated) for runs in (contrasts, expected))
    return 2 * sum(_evidence(lines[:, b], moved[:, b]) for b in _bands(lines.shape[1])) > LEVELS.separated_by_readings


def _contrasts(series: Array, repeats: int) -> Array:
    """Contrasts (R - 1, p, N) of the repeats of a series (n, p)."""
    runs = series.reshape(repeats, -1, series.shape[1])
    return np.asarray(np.einsum("cr,rnp->cpn", scipy.linalg.helmert(repeats), runs))


def _with_past(runs: Array) -> NDArray[np.bool_]:
    """Which samples (c N,) of runs (c, p, N) have one before them in their own run."""
    free = np.ones((runs.shape[0], runs.shape[2]), dtype=bool)
    free[1:, 0] = False
    return free.ravel()


def _lines(runs: Array) -> Spectrum:
    """Complex lines (c, m, q) of runs (c, n, q): neither that of their mean nor, of an even number, the highest."""
    return np.asarray(np.fft.rfft(runs, axis=1)[:, 1 : (runs.shape[1] + 1) // 2])


def _evidence(lines: Spectrum, moved: Spectrum) -> float:
    """Logarithm of the ratio of likelihoods of lines (c, m, q) of one noise power: with those of the motion, without.

    Of a power that is only rounding the ratio is limited.
    """
    count = lines.shape[0] * lines.shape[1]
    power, left = (np.sum(np.abs(series) ** 2, axis=(0, 1)) for series in (lines, lines - moved))
    seen = power > 0
    return float(count * np.log(power[seen] / np.maximum(left[seen], ROUNDING * power[seen])).sum())


def _bands(lines: int) -> list[slice]:
    """Bands of a spectrum's lines, none of fewer than `FEWEST_LINES` if there are as many."""
    edges = [0]
    for edge in (np.geomspace(1, lines + 1, SPECTRUM_BANDS + 1) - 1).astype(int):
        if edge - edges[-1] >= FEWEST_LINES:
            edges.append(int(edge))
    return [slice(a, b) for a, b in pairwise([*(edges[:-1] or [0]), lines])]


def _decorrelation(series: Array) -> Array:
    """Matrix (p, q) that makes a series (n, p) of zero mean uncorrelated and of unit variance, q <= p."""
    size = np.sqrt((series**2).mean(axis=0))
    seen = size > 0
    scale = np.diag(1 / np.where(seen, size, 1.0))[:, seen]
    unit = series @ scale
    variances, vectors = np.linalg.eigh(unit.T @ unit / len(unit))
    regular = variances > ROUNDING
    return np.asarray(scale @ vectors[:, regular] / np.sqrt(variances[regular]))


GROSS = 0.25
"""Root-mean-square difference of a repeat from the others over the motion's standard deviation, from which on they are
no repeats: its square, the share that a score test may miss, is 6 % there."""
NEGLIGIBLE = 1e-5
"""The same, below which a difference is none: it changes the wrench by less than any sensor resolves."""
JUMP = 2.0
"""Residual power of a spline over the whole record over that of splines of each repeat, from which on the motion jumps
between repeats: they were recorded one by one."""

NO_REPEATS = "leave it out; or number the repeats by the motion's period; or take all as one run by --no-period"
"""What mends repeats that are none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionDifference:
    """What the repeats' motion adds to the mean one: series (n, k), and its first two derivatives, per s and per s²."""

    value: Array
    first: Array
    second: Array


def difference_of(series: Array, repeats: int) -> Array:
    """Series (n, k) less its mean over the repeats."""
    runs = series.reshape(repeats, -1, series.shape[1])
    return np.asarray((runs - runs.mean(axis=0)).reshape(series.shape))


def differing_columns(series: Array, repeats: int, *, continuous: bool) -> NDArray[np.bool_]:
    """Which columns (k,) of a motion (n, k) differ between the repeats beyond their noise."""
    differences = difference_of(series, repeats)
    size = np.sqrt((differences**2).mean(axis=0))
    differing = size > NEGLIGIBLE * max(float(series.std(axis=0).max()), np.finfo(float).tiny)
    if not differing.any():
        return np.asarray(differing)
    runs = differences.reshape(repeats, -1, series.shape[1])
    parts = [runs, differences[None]] if continuous else [runs]
    tests = sum(series.shape[0] * (series.shape[1] // 2 + 1) for series in parts) * series.shape[1]
    bound = np.log(tests / LEVELS.repeat_motion)
    largest = np.max([_largest_line(series) for series in parts], axis=0)
    return np.asarray(differing & (largest > bound))


def _largest_line(runs: Array) -> Array:
    """Largest line of any run (R, N, k) over the noise floor of all, per column: noise lines are exponential."""
    samples = runs.shape[1]
    window = np.sin(np.pi * (np.arange(samples) + 0.5) / samples) ** 6  # no leakage into the upper octaves
    power = np.abs(np.fft.rfft(runs * window[:, None], axis=1)) ** 2
    floors = np.stack([line_noise_floor(column) for column in power.mean(axis=0).T], axis=1)
    return np.asarray((power / np.maximum(floors, np.finfo(float).tiny)).max(axis=(0, 1)))


def motion_difference(
    series: Array, mean: Array, repeats: int, dt: float, *, continuous: bool, antiperiodic: bool = False
) -> MotionDifference:
    """What a motion (n, k), sampled every `dt` s, adds to its smooth mean (n, k); zero in columns that do not differ.

    The mean is that whose derivatives are known: x - mean is smooth across the repeats then, even where a motion that
    drifts leaves the average of the samples with a step. An `antiperiodic` series changes sign from one repeat to the
    next, and is given without.
    """
    zero = np.zeros_like(series)
    difference = MotionDifference(value=zero, first=zero.copy(), second=zero.copy())
    columns = differing_columns(series, repeats, continuous=continuous)
    if not columns.any():
        return difference
    sign = np.where(np.arange(repeats) % 2 == 0, 1.0, -1.0) if antiperiodic else np.ones(repeats)
    signs = np.repeat(sign, len(series) // repeats)[:, None]
    smooth = _smooth_derivatives((series - mean)[:, columns] * signs, repeats, dt, continuous)
    for target, derivative in zip((difference.value, difference.first, difference.second), smooth, strict=True):
        target[:, columns] = derivative * signs
    return difference


def _smooth_derivatives(series: Array, repeats: int, dt: float, continuous: bool) -> tuple[Array, ...]:
    """A series (n, k) and its derivatives by splines: of the whole record, or of each repeat where it jumps."""
    columns = series.shape[1]
    runs = series.reshape(repeats, -1, columns).transpose(1, 0, 2).reshape(-1, repeats * columns)
    single = spline_derivatives(runs, dt)
    if continuous:
        whole = spline_derivatives(series, dt)
        misfit, least = ((whole.value - series) ** 2).mean(), ((single.value - runs) ** 2).mean()
        if misfit < max(JUMP * least, (NEGLIGIBLE * float(series.std())) ** 2):
            return whole.value, whole.first, whole.second
    parts = (single.value, single.first, single.second)
    return tuple(runs.reshape(-1, repeats, columns).transpose(1, 0, 2).reshape(series.shape) for runs in parts)


@dataclass(frozen=True, kw_only=True)
class RepeatDeviation:
    """By how much the motion of one repeat differs from that of the others, which is the median of all.

    repeat     its position, from 0 on
    deviation  root-mean-square difference over the motion's standard deviation
    late       samples by which it is late, where moving it by them halves the difference; else None
    """

    repeat: int
    deviation: float
    late: int | None = None

    @classmethod
    def largest(cls, series: Array, repeats: int) -> RepeatDeviation:
        """The largest of a motion (n, k) in columns of one unit."""
        runs = series.reshape(repeats, -1, series.shape[1])
        usual = np.median(runs, axis=0)
        size = max(float(np.sqrt(series.var(axis=0).sum())), np.finfo(float).tiny)
        differences = np.sqrt(((runs - usual) ** 2).mean(axis=1).sum(axis=1)) / size
        worst = int(np.argmax(differences))
        others = np.median(np.delete(runs, worst, axis=0), axis=0)
        late = _lateness(runs[worst], others)
        moved = np.sqrt(((np.roll(others, late, axis=0) - runs[worst]) ** 2).mean(axis=0).sum()) / size
        deviation = float(differences[worst])
        return cls(repeat=worst, deviation=deviation, late=late if late and moved < deviation / 2 else None)

    @property
    def gross(self) -> bool:
        """Whether the repeat is none of this motion."""
        return self.deviation > GROSS

    def sentence(self, dt: float) -> str:
        """The difference in words, without a subject; `dt` in s."""
        what = f"differs from that of the others by {self.deviation:.0%} of the motion's standard deviation"
        if self.late is None:
            return what
        return f"{what}: it is {abs(self.late) * dt:.3g} s {'late' if self.late > 0 else 'early'}"


def largest_deviation(columns: Mapping[str, Array], repeats: int) -> RepeatDeviation | None:
    """The largest difference of a repeat's motion from the others', in columns (n,); None where nothing moves."""
    moving = [component.values for component in motion_components(columns) if component.moves]
    return max((RepeatDeviation.largest(x, repeats) for x in moving), key=lambda d: d.deviation, default=None)


def _lateness(run: Array, others: Array) -> int:
    """Samples by which a run (N, k) is late, by the largest of its circular correlation."""
    centred = [np.fft.rfft(series - series.mean(axis=0), axis=0) for series in (run, others)]
    correlation = np.fft.irfft((centred[0] * centred[1].conj()).sum(axis=1), len(run))
    late = int(np.argmax(correlation))
    return late if late <= len(run) // 2 else late - len(run)
