"""Motion and its derivatives, no wider in frequency than the motion stands out of its own noise."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.regression_spline import RegressionSpline

Array = NDArray[np.float64]

FALSE_LINE = 0.01  # chance that pure noise keeps a line at all
END_KNOTS = 2  # left out at each end of a spline in coloured noise
DEGREE = 5  # a quintic's second derivative is still smooth
COEFFICIENTS_PER_LINE = 10  # of a spline: a period takes several to be followed as closely as clean data ask


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivatives:
    """A series and its first two derivatives in time, each (N, k), per s and per s².

    `score` (k,) is the Bayesian information criterion n ln RSS + p ln n of the description, by which two
    descriptions of the same series can be compared.
    """

    value: Array
    first: Array
    second: Array
    score: Array


def periodic_series(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Fourier series of one period (N, k), sampled every dt s, and its exact derivatives.

    x(t) = sum_|h|<=K c_h exp(i w_h t), w_h = 2 pi h / (N dt); derivatives multiply by i w_h. K is the last
    line that stands out of the floor, per column: quantisation of a resolver repeats in every period, so no
    averaging takes it away, and every line kept beyond the motion's adds it times w_h².
    An `antiperiodic` column changes sign after a period, as a quaternion does after a full turn:
    its lines lie at h + 1/2.
    """
    samples = len(mean)
    shift = 0.5 if antiperiodic else 0.0
    carrier = np.exp(-2j * np.pi * shift * np.arange(samples) / samples)[:, None]
    spectrum = np.fft.fft(mean * carrier, axis=0)
    order = np.fft.fftfreq(samples, 1 / samples) + shift
    if not antiperiodic and samples % 2 == 0:
        order[samples // 2] *= -1  # the line at half the rate is its own mirror image
    ascending = np.argsort(np.where(order >= 0, order, np.inf))[: int(np.sum(order >= 0))]
    power = np.abs(spectrum[ascending]) ** 2
    last = np.array([leading_lines(column) for column in power.T])
    kept = np.where(np.abs(order)[:, None] <= last + shift, spectrum, 0)
    rate = 2j * np.pi * order[:, None] / (samples * dt)
    value, first, second = (np.real(np.fft.ifft(kept * rate**n, axis=0) * np.conj(carrier)) for n in range(3))
    return Derivatives(value=value, first=first, second=second, score=_score(mean - value, 2 * last + 1))


def smooth(run: Array, dt: float) -> Derivatives:
    """One run (N, k), sampled every dt s, as quintic regression splines with uniform knots.

    The number of coefficients minimises n ln RSS + p ln n (Schwarz), per column, below a cap: noise of a real
    encoder is coloured, which every criterion for white noise takes for motion. The cap comes from the
    highest line of the windowed spectrum in any column that stands out of the floor (one motion moves all).
    A least-squares spline has no phase, and no end condition that would pull the acceleration there.
    """
    samples = len(run)
    powers = _windowed_power(run).T
    lines = max(leading_lines(power) for power in powers)
    # An end has data on one side only: noise that falls faster than 1/f bends short end pieces.
    end_knots = END_KNOTS if any(map(_coloured, powers)) else 0
    most = min(samples // 2, DEGREE + 1 + COEFFICIENTS_PER_LINE * max(lines, 1))
    counts = np.unique(np.round(np.geomspace(DEGREE + 1, max(most, DEGREE + 1), 30)).astype(int))
    fits = [_Fit.of(run, int(count), end_knots) for count in counts]
    best = np.argmin([fit.score for fit in fits], axis=0)
    described = {i: fits[i].derivatives(dt) for i in {*best.tolist()}}
    return _columns([described[i] for i in best])


def best_description(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Mean of separate runs (N, k): as a period when that describes it with less, else as a single run.

    A motion that ends where it began with the same velocity needs few lines; one that does not needs
    very many, and the spline wins by its score.
    """
    closed, opened = periodic_series(mean, dt, antiperiodic=antiperiodic), smooth(mean, dt)
    return closed if closed.score.sum() <= opened.score.sum() else opened


def leading_lines(power: Array) -> int:
    """Index of the last line of a power spectrum (lines 0, 1, 2, ..) that motion needs.

    Noise lines over their floor are exponential with mean one, so that the largest of M exceeds
    ln(M / FALSE_LINE) in one of a hundred spectra. The cut is where the sum of (power / floor - that) over
    the lines up to it is largest: a strong line pays for empty ones before it, a chance one does not.
    """
    bound = np.log(max(len(power), 2) / FALSE_LINE)
    # Paying for every line is enough; more would drown the later lines in the rounding of the sum.
    excess = np.minimum(power[1:] / noise_floor(power)[1:], 2 * bound * len(power))
    gain = np.cumsum(excess - bound)
    return int(np.argmax(np.concatenate([[0.0], gain])))


def noise_floor(power: Array) -> Array:
    """Expected noise power of each line, (M,), from the lines where there is nothing but noise.

    A robust line through log power against log frequency over the upper three octaves, falling at most as
    f^-4 and never rising: measured noise is coloured, and linear interpolation of a slow log falls as f^-4.
    The median of exponential noise is ln 2 of its mean. Few lines: their upper half's median.
    """
    lines = np.arange(len(power), dtype=float)
    rounding = np.finfo(float).eps ** 2 * float(power.max()) + np.finfo(float).tiny
    if len(power) < 64:
        flat = float(np.median(power[len(power) // 2 :])) / np.log(2)
        return np.full(len(power), max(flat, rounding))
    edges = np.unique(np.round(np.geomspace(len(power) / 8, len(power), 9)).astype(int))
    pieces = [slice(a, b) for a, b in pairwise(edges)]
    level = np.log([max(float(np.median(power[piece])) / np.log(2), rounding) for piece in pieces])
    middle = np.log([float(lines[piece].mean()) for piece in pieces])
    slope = float(np.clip(_robust_slope(level, middle), -4.0, 0.0))
    height = float(np.median(level - slope * middle))
    floor: Array = np.maximum(np.exp(height + slope * np.log(np.maximum(lines, 1.0))), rounding)
    return floor


def _robust_slope(values: Array, places: Array) -> float:
    """Median of the slopes between all pairs of points (Theil and Sen)."""
    first, second = np.triu_indices(len(values), 1)
    return float(np.median((values[second] - values[first]) / (places[second] - places[first])))


def _coloured(power: Array) -> bool:
    floor = noise_floor(power)
    return bool(floor[1] > len(floor) * floor[-1])


def _windowed_power(run: Array) -> Array:
    """Spectrum (M, k) of a run without its cubic trend, under a window whose leakage falls as f^-14."""
    samples = len(run)
    place = np.linspace(-1, 1, samples)
    trend = np.polynomial.polynomial.polyfit(place, run, 3)
    rest = run - np.polynomial.polynomial.polyval(place, trend).T
    window = np.sin(np.pi * (np.arange(samples) + 0.5) / samples) ** 6
    power: Array = np.abs(np.fft.rfft(rest * window[:, None], axis=0)) ** 2
    return power


@dataclass(frozen=True, eq=False)
class _Fit:
    """A spline over place, which is time in steps of the knots: that keeps the equations well scaled whatever dt is."""

    spline: RegressionSpline
    place: Array
    value: Array
    score: Array

    @classmethod
    def of(cls, run: Array, coefficients: int, end_knots: int) -> _Fit:
        longer = end_knots if coefficients > DEGREE + 1 + 2 * end_knots else 0
        pieces = coefficients - DEGREE + 2 * longer
        place = np.linspace(0.0, pieces, len(run))
        inner = np.arange(1.0 + longer, pieces - longer)
        knots = np.concatenate([[0.0] * (DEGREE + 1), inner, [float(pieces)] * (DEGREE + 1)])
        spline, value = RegressionSpline.nearest(place, run, knots, DEGREE)
        return cls(spline, place, value, _score(run - value, np.full(run.shape[1], coefficients)))

    def derivatives(self, dt: float) -> Derivatives:
        scale = self.place[-1] / ((len(self.place) - 1) * dt)
        slope = self.spline.derivative()
        first, second = slope(self.place) * scale, slope.derivative()(self.place) * scale**2
        return Derivatives(value=self.value, first=first, second=second, score=self.score)


def _score(residual: Array, parameters: NDArray[np.int64]) -> Array:
    samples = len(residual)
    squares = np.sum(residual**2, axis=0) + np.finfo(float).tiny
    score: Array = samples * np.log(squares) + parameters * np.log(samples)
    return score


def _columns(fits: list[Derivatives]) -> Derivatives:
    """Column j of the j-th of k descriptions."""
    value, first, second = (
        np.stack([getattr(fit, name)[:, j] for j, fit in enumerate(fits)], axis=1)
        for name in ("value", "first", "second")
    )
    score = np.array([fit.score[j] for j, fit in enumerate(fits)])
    return Derivatives(value=value, first=first, second=second, score=score)
