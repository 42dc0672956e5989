"""Intervals of estimates whose noise is itself estimated: Student's quantiles, each with its own degrees of freedom."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import zeta

from estimation.directions import orthonormal
from estimation.distributions import student_isf
from estimation.fit import Fit, Problem, table
from estimation.noise import Noise, NoiseSource
from estimation.recording import Recording
from estimation.spectrum import FEWEST, Spectrum, smooth_spectrum

Array = NDArray[np.float64]

SURE = 1e4
"""Degrees of freedom from which on a quantile is the normal one to four digits: no more are counted."""
LEAST = 2.0
"""Fewest degrees of freedom: the squares of the slowest line of a record, which a curve continued below it forgets."""
LEFT = 0.5
"""Share of a line's power that a fit must leave for the line to tell the noise's, as between the motion's lines."""
NEWTON_STEP = 1e-8
"""Of x: after a step as short as that, the next, which is of the order of its square, is lost in rounding."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """Two-sided intervals of a fit's unknowns, in the order of its `theta`.

    std      (k,) standard deviation; of a single run it is that of the noise which the autoregression left coloured
    freedom  (k,) degrees of freedom with which that is known
    """

    fit: Fit
    level: float
    std: Array
    freedom: Array

    @property
    def half_width(self) -> Array:
        """(k,) t quantile times std; infinite where the recordings do not show an unknown."""
        reach = student_isf(0.5 - self.level / 2, self.freedom)
        return np.asarray(np.where(self.fit.shown, reach * self.std, np.inf))

    @property
    def low(self) -> Array:
        """Lower ends (k,)."""
        return np.asarray(self.fit.theta - self.half_width)

    @property
    def high(self) -> Array:
        """Upper ends (k,)."""
        return np.asarray(self.fit.theta + self.half_width)

    def rows(self) -> list[tuple[str, ...]]:
        """Name, value, std, degrees of freedom, both ends and unit of every unknown, as text."""
        columns = zip(self.fit.unknowns, self.fit.theta, self.std, self.freedom, self.low, self.high, strict=True)
        return [
            (p.name, f"{value:.6g}", f"{std:.2g}", f"{nu:.3g}", f"{low:.6g}", f"{high:.6g}", p.unit)
            if np.isfinite(low)
            else (p.name, "-", "not shown", "-", "-", "-", p.unit)
            for p, value, std, nu, low, high in columns
        ]

    def __str__(self) -> str:
        ends = (f"{100 * self.level:g} % from", "to")
        return table(("parameter", "value", "std", "freedom", *ends, "unit"), self.rows())


def intervals(fit: Fit, *, level: float = 0.95, pull: Array | None = None) -> Intervals:
    """Intervals that cover the truth as often as they say, though the noise was estimated from the same recordings.

    theta's error is sum_r a_rj w_r over the whitened rows' noise w, with the pull a = D C of least squares (rows, k),
    or the one given. Its variance is sum_r a_rj² times the power of row r, which is 1 as far as whitening succeeded:
    every row was divided by an estimate. With q_r the variance's shares and v = var(sum_r q_r log power_r) (`doubt`)
    the variance is known like a chi-square of f degrees of freedom, whose logarithm varies by trigamma(f / 2):
    f = 2 trigamma^-1(v) (F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114, on the logarithm). Error over std
    is then Student's t with f degrees of freedom.

    A single run is whitened by an autoregression of its own residual, whose slow part rests on few samples and on the
    orders tried. The whitened residual's spectrum is therefore estimated again, as a smooth curve, and counted in
    (prewhitening: D. W. K. Andrews and J. C. Monahan, Econometrica 60 (1992) 953-966), with the doubt of that curve.
    """
    residual, derivative = Problem(fit.layout, fit.recordings, fit.noise).evaluate(fit.theta)
    pull = derivative @ fit.covariance if pull is None else pull
    parts = list(_parts(fit, residual, derivative, pull))
    variance = np.sum([part.variance for part in parts], axis=0)
    safe = np.maximum(variance, 1e-300)
    doubt = np.sum([part.doubt(safe) for part in parts], axis=0)
    freedom = np.array([freedom_of(float(v)) for v in doubt])
    return Intervals(fit, level, np.sqrt(variance), freedom)


def freedom_of(doubt: float) -> float:
    """Degrees of freedom, `LEAST` to `SURE`, of a power whose logarithm has the variance `doubt`."""
    return float(np.clip(2 * inverse_trigamma(doubt), LEAST, SURE)) if doubt > 0 else SURE


def inverse_trigamma(value: float) -> float:
    """The x > 0 at which trigamma(x) = zeta(2, x) has this value.

    By Newton's method on 1 / trigamma, which is convex and near to linear: from 1/2 + 1 / value on it comes down to x
    without passing it (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004, appendix).
    """
    x, step = 0.5 + 1 / value, np.inf
    while step > NEWTON_STEP * x:
        trigamma = zeta(2, x)
        step = trigamma * (1 - trigamma / value) / (2 * zeta(3, x))
        x -= step
    return float(x)


class Part(ABC):
    """What one recording adds to the variance of every unknown."""

    @property
    @abstractmethod
    def variance(self) -> Array:
        """(k,)."""

    @abstractmethod
    def doubt(self, total: Array) -> Array:
        """Variance (k,) of the logarithm of all recordings' `total` variance that comes from this one's noise."""


@dataclass(frozen=True, eq=False)
class RowPart(Part):
    """Rows as they were whitened: squared pulls (rows, k)."""

    noise: Noise
    squares: Array

    @property
    def variance(self) -> Array:
        """The sum of the squares."""
        return np.asarray(self.squares.sum(axis=0))

    def doubt(self, total: Array) -> Array:
        """By the noise's own."""
        return self.noise.doubt_of(self.squares / total)


@dataclass(frozen=True, eq=False)
class LinePart(Part):
    """Rows of a single run in cosine lines: per channel squared pulls times power (lines, k), and the power's curve."""

    frequency: Array
    spectra: tuple[Spectrum, ...]
    squares: tuple[Array, ...]

    @property
    def variance(self) -> Array:
        """The sum over channels and lines."""
        return np.asarray(np.sum([s.sum(axis=0) for s in self.squares], axis=0))

    def doubt(self, total: Array) -> Array:
        """By the curves', which belong to channels that are independent of each other."""
        parts = zip(self.spectra, self.squares, strict=True)
        return np.asarray(sum(curve.joint_doubt(self.frequency, squares / total) for curve, squares in parts))


def _parts(fit: Fit, residual: Array, derivative: Array, pull: Array) -> Iterator[Part]:
    span = orthonormal(derivative)
    ends = np.cumsum([noise.whitener.rows for noise in fit.noise])[:-1]
    own = zip(*(np.split(rows, ends) for rows in (residual, span, pull)), strict=True)
    for recording, noise, (left, reached, pulled) in zip(fit.recordings, fit.noise, own, strict=True):
        if _coloured(recording, noise):
            yield _lines(len(recording.channels), left, reached, pulled)
        else:
            yield RowPart(noise, pulled**2)


def _coloured(recording: Recording, noise: Noise) -> bool:
    """Whether rows are a run's innovations, which may have a colour left, and enough of them to see it."""
    lines = noise.whitener.rows // len(recording.channels)
    return noise.source is NoiseSource.RESIDUAL and not recording.at_rest and lines > 2 * FEWEST


def _lines(channels: int, residual: Array, span: Array, pull: Array) -> LinePart:
    """One run's rows in cosine lines, each channel with the spectrum of its residual there.

    A fit takes the share h of a line's power, h the squares of an orthonormal basis of the derivative's columns.
    """
    left, reached, pulled = (_in_lines(rows, channels) ** 2 for rows in (residual[:, None], span, pull))
    kept = 1 - reached.sum(axis=2)
    ordinates = np.where(kept > LEFT, left[:, :, 0] / np.maximum(kept, LEFT), 0.0)
    # The mean is a line of its own, half a line below the first: its power is the curve's continued.
    frequency = np.maximum(np.arange(len(left)), 0.5) / (2 * len(left))
    spectra = tuple(smooth_spectrum(frequency[1:], o[1:], shape=0.5, start=float(frequency[0])) for o in ordinates.T)
    squares = (
        pulled[:, c] * _power(spectrum, frequency, ordinates[:, c])[:, None] for c, spectrum in enumerate(spectra)
    )
    return LinePart(frequency, spectra, tuple(squares))


def _in_lines(rows: Array, channels: int) -> Array:
    """Rows (lines channels, k) of a run as cosine lines (lines, channels, k)."""
    return np.asarray(dct(rows.reshape(-1, channels, rows.shape[1]), axis=0, norm="ortho"))


def _power(spectrum: Spectrum, frequency: Array, ordinates: Array) -> Array:
    """The curve, and at a tone what is there."""
    level = spectrum(frequency)
    level[1:] = np.where(spectrum.tones, np.maximum(level[1:], ordinates[1:]), level[1:])
    return level
