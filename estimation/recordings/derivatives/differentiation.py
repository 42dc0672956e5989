"""Derivatives of a sampled motion: truncated Fourier series (periodic) or smoothing splines (single run).

The bandwidth of a Fourier series ends where the motion's spectrum falls below its noise floor, that of a smoothing
spline where the likelihood puts it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.derivatives.b_spline import BasisRows
from estimation.recordings.derivatives.recent_derivatives import RecentDerivatives
from estimation.recordings.derivatives.sample_hold import TrueSamples
from estimation.recordings.derivatives.series_derivatives import Derivatives
from estimation.recordings.derivatives.smoothing_spline import SmoothingSpline
from modeling.significance import LEVELS

Array = NDArray[np.float64]

RECENT = RecentDerivatives()


def fourier_derivatives(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Fourier series of one period (N, k), sampled every dt s, and its exact derivatives.

    x(t) = sum_|h|<=K c_h exp(i w_h t), w_h = 2 pi h / (N dt); derivatives multiply by i w_h. K is the
    highest excited line above the noise floor, per column: quantisation of a resolver repeats in every period, so that
    averaging does not reduce it, and every further line adds it times w_h².
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
    highest = np.array([highest_excited_line(column) for column in power.T])
    truncated = np.where(np.abs(order)[:, None] <= highest + shift, spectrum, 0)
    rate = 2j * np.pi * order[:, None] / (samples * dt)
    value, first, second = (np.real(np.fft.ifft(truncated * rate**n, axis=0) * np.conj(carrier)) for n in range(3))
    score = _bayesian_information_criterion(mean - value, 2 * highest + 1)
    return Derivatives(value=value, first=first, second=second, score=score)


def spline_derivatives(run: Array, dt: float, true: TrueSamples | None = None) -> Derivatives:
    """One run (N, k), sampled every dt s, as smoothing splines; of its `true` samples alone where values are held.

    Smoothness and the noise of the samples are those of the largest likelihood, the same for all columns. They do not
    depend on the unit of time: a series is smoothed with samples one apart, and only once (`RecentDerivatives`).
    """
    run = np.asarray(run, dtype=np.float64)
    every = np.arange(len(run))
    rows = every if true is None else true.rows
    places = every.astype(np.float64) if true is None else true.instants / dt
    found, spline = RECENT.get((rows, places, run), lambda: _smoothed(rows, places, run))
    first, second = found.first / dt, found.second / dt**2
    return replace(found, first=first, second=second, spline=spline.with_samples_every(dt))


def _smoothed(rows: NDArray[np.intp], places: Array, run: Array) -> tuple[Derivatives, SmoothingSpline]:
    """Derivatives per row and row² of a run (N, k), by a smoothing spline through some rows, true at places in rows."""
    spline = SmoothingSpline.of(places, run[rows])
    found = SplineTimes.of(spline, np.arange(len(run), dtype=np.float64)).derivatives(spline)
    return replace(found, score=_bayesian_information_criterion(run - found.value, spline.freedom)), spline


@dataclass(frozen=True, eq=False)
class SplineTimes:
    """Times at which a smoothing spline, and others drawn from it, are differentiated.

    rows    the B-splines there, or at the first or last sample where that is nearer
    beyond  (N, 1) s after the last sample, or before the first, < 0
    """

    rows: BasisRows
    beyond: Array

    @classmethod
    def of(cls, spline: SmoothingSpline, times: Array) -> SplineTimes:
        """Times (N,), s, for splines on these knots."""
        inside = np.clip(times, spline.start, spline.end)
        return cls(spline.rows(inside, 2), (times - inside)[:, None])

    def derivatives(self, spline: SmoothingSpline) -> Derivatives:
        """Of the spline at the times; with constant acceleration before its first and after its last sample."""
        value, first, second = spline.derivatives(self.rows)
        value, first = value + self.beyond * first + self.beyond**2 / 2 * second, first + self.beyond * second
        return Derivatives(value=value, first=first, second=second, score=np.zeros(value.shape[1]), spline=spline)


def fourier_or_spline_derivatives(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Mean of separate runs (N, k): as a period where that has the lower score, else as a single run.

    A motion that ends where it began with the same velocity needs few lines; one that does not needs very many, and
    the spline has the lower score.
    """
    periodic, single = fourier_derivatives(mean, dt, antiperiodic=antiperiodic), spline_derivatives(mean, dt)
    return periodic if periodic.score.sum() <= single.score.sum() else single


def highest_excited_line(power: Array) -> int:
    """Index of the highest excited line of a power spectrum (lines 0, 1, 2, ..).

    Noise lines over their floor are exponential with mean one, so that the largest of M exceeds
    ln(M / LEVELS.excited_line) in one of a hundred spectra. The cut is where the sum of (power / floor - that bound)
    over the lines up to it is largest: a strong line outweighs empty ones below it, a chance one does not.
    """
    bound = np.log(max(len(power), 2) / LEVELS.excited_line)
    # Clipped at what outweighs all lines: larger terms would lose later lines in the rounding of the sum.
    excess = np.minimum(power[1:] / line_noise_floor(power)[1:], 2 * bound * len(power))
    gain = np.cumsum(excess - bound)
    return int(np.argmax(np.concatenate([[0.0], gain])))


def line_noise_floor(power: Array) -> Array:
    """Expected noise power of each line, (M,), from the lines without motion.

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


def _bayesian_information_criterion(residual: Array, parameters: NDArray[np.int64] | float) -> Array:
    samples = len(residual)
    squares = np.sum(residual**2, axis=0) + np.finfo(float).tiny
    score: Array = samples * np.log(squares) + parameters * np.log(samples)
    return score
