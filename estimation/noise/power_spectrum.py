"""Smooth power spectral density from periodogram ordinates by penalised Whittle likelihood, robust against tones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import gamma_isf
from estimation.recordings.derivatives.b_spline import basis_matrix
from modeling.errors import InputError
from modeling.significance import LEVELS

Array = NDArray[np.float64]

MAX_TONE_ROUNDS = 4
"""Fits of the curve, each without the tones that the last one left above it."""
EULER = 0.5772
"""Mean of -log of an exponential variable of mean one."""
MIN_ORDINATES = 8
"""Ordinates below which a curve of four coefficients and its smoothness are not identifiable."""
CURVATURE_PRIORS = (1.0, 0.5)
"""Standard deviations, a priori, of d² log S / d log f² over a unit of log f, from which Akaike's criterion chooses.
The curvature of a first-order corner is 1 at the most, that of 1/f noise meeting a white floor 1/4: a stiffer curve
would not follow it to the few lines where drift is tested, whatever the many lines above give."""


MAX_PIECES = 24
"""Pieces of a spline in log f; twice as many in a `log_frequency` with an end, whose range is about twice as large."""


@dataclass(frozen=True, eq=False)
class PowerSpectrum:
    """log S as a penalised cubic spline in u(f): S(f) in the square of the signal's unit, per sample.

    tones   which of the ordinates were identified as tones and left out of the fit
    freedom effective number of parameters of the curve
    lowest  u of the lowest ordinate; below it the curve is extrapolated under the penalty
    nyquist half the sampling rate (Hz) where the curve is in `log_frequency` below it; infinite for log f
    """

    knots: Array
    coefficients: Array
    covariance: Array
    tones: NDArray[np.bool_]
    freedom: float
    lowest: float
    nyquist: float = inf

    def __call__(self, frequency: Array) -> Array:
        """S at positive frequencies; below the ordinates never less than at the lowest.

        An extrapolation falling towards zero frequency would make drift falsely significant.
        """
        return power_levels([self], frequency)[:, 0]

    def level(self, frequency: Array, basis: Array) -> Array:
        """S at positive frequencies (m,), by `basis` there."""
        curve, below = basis @ self.coefficients, log_frequency(frequency, self.nyquist) < self.lowest
        if below.any():
            curve[below] = np.maximum(curve[below], self._rows(np.array([self.lowest])) @ self.coefficients)
        return np.asarray(np.exp(curve))

    def log_variance(self, frequency: Array) -> Array:
        """Posterior variance of log S at these frequencies; it grows where the curve is extrapolated."""
        return log_power_variances([self], frequency)[:, 0]

    def basis(self, frequency: Array) -> Array:
        """Values (m, j) of the curve's j basis functions at frequencies (m,)."""
        return self._rows(log_frequency(frequency, self.nyquist))

    def mean_log_variance(self, basis: Array, shares: Array) -> Array:
        """Variance (g,) of the mean of log S over frequencies with the weights `shares` (m, g), by `basis` there."""
        loads = basis.T @ shares
        return np.asarray(((self.covariance @ loads) * loads).sum(axis=0))

    def _rows(self, u: Array) -> Array:
        """Basis values at u, constant beyond the end knots."""
        low, high = self.knots[3], self.knots[-4]
        return basis_matrix(np.clip(u, low, high), self.knots, 3)


def log_frequency(frequency: Array, nyquist: float = inf) -> Array:
    """u = log(2 fN / pi tan(pi f / 2 fN)) of positive frequencies (Hz): log f, but endless at half the sampling rate.

    There a filtered series has next to no power: the spectrum of a Butterworth filter, whose zeros are there, is
    1 / (1 + (f / corner)^2k) in the frequency exp(u), and nearly a straight line in u above its corner.
    """
    if nyquist == inf:
        return np.asarray(np.log(frequency))
    angle = np.pi / 2 * np.minimum(frequency / nyquist, 1.0)
    return np.asarray(np.log(2 * nyquist / np.pi * np.tan(angle)))


def power_levels(spectra: Sequence[PowerSpectrum], frequency: Array) -> Array:
    """S (m, p) of several spectra at positive frequencies (m,)."""
    of_each = zip(spectra, bases(spectra, frequency), strict=True)
    return np.stack([s.level(frequency, basis) for s, basis in of_each], axis=1)


def log_power_variances(spectra: Sequence[PowerSpectrum], frequency: Array) -> Array:
    """Posterior variance (m, p) of log S of several spectra at positive frequencies (m,)."""
    of_each = zip(spectra, bases(spectra, frequency), strict=True)
    return np.stack([np.einsum("ij,ij->i", basis @ s.covariance, basis) for s, basis in of_each], axis=1)


def bases(spectra: Sequence[PowerSpectrum], frequency: Array) -> list[Array]:
    """Values (m, j) of each spectrum's basis functions; those of one record mostly have the same knots."""
    different = {(s.nyquist, s.knots.tobytes()): s for s in spectra}
    values = {key: s.basis(frequency) for key, s in different.items()}
    return [values[s.nyquist, s.knots.tobytes()] for s in spectra]


def smooth_power_spectrum(
    frequency: Array, ordinates: Array, *, shape: float = 1.0, start: float | None = None
) -> PowerSpectrum:
    """`smooth_power_spectra` of one series, ordinates (m,)."""
    return smooth_power_spectra(frequency, ordinates[:, None], shape=shape, start=start)[0]


def smooth_power_spectra(
    frequency: Array,
    ordinates: Array,
    *,
    shape: float = 1.0,
    start: float | None = None,
    nyquist: float = inf,
) -> tuple[PowerSpectrum, ...]:
    """Fit log S(f) to periodogram ordinates of each of p series by penalised Whittle likelihood.

    frequency  (m,) positive; ordinates (m, p) with mean S(f), distributed as Gamma of the given shape (1 for a single
    periodogram, R-1 for an average over R-1 differences); `start` the lowest frequency at which S will be evaluated;
    `nyquist` half the sampling rate (Hz) of series that were filtered.
    With the log link the Fisher information of each ordinate is `shape` whatever S, so that each scoring step is one
    penalised least-squares solve; the penalty on the curvature is chosen by Akaike's criterion. Ordinates above the
    Bonferroni-corrected Gamma quantile (`LEVELS.ordinate`) are tones and left out, with their neighbours.
    """
    begin = float(frequency.min()) if start is None else min(start, float(frequency.min()))
    grid = _Grid(log_frequency(frequency, nyquist), float(log_frequency(np.array([begin]), nyquist)[0]), nyquist)
    return tuple(_smoothed(grid, column, shape) for column in ordinates.T)


def _smoothed(grid: _Grid, ordinates: Array, shape: float) -> PowerSpectrum:
    """The spectrum of ordinates (m,), without those that are tones."""
    valid = np.isfinite(ordinates) & (ordinates > 0)
    if valid.sum() < MIN_ORDINATES:
        raise InputError(
            what="too few Fourier lines to estimate a channel's noise spectrum",
            where="recording",
            remedy="record longer, or the raw sensor instead of rounded readings",
        )
    limit = gamma_isf(LEVELS.ordinate / len(ordinates), shape) / shape
    tones, rounds = ~valid, MAX_TONE_ROUNDS
    while True:
        curve, level = _penalised_spline(grid, ordinates, ~tones, shape)
        exceeding = valid & (ordinates > limit * level)
        found = tones | exceeding | np.roll(exceeding, 1) | np.roll(exceeding, -1)
        settled, rounds = (found == tones).all() or found.mean() > 0.3, rounds - 1
        tones = tones if settled else found
        if settled or not rounds:
            return replace(curve, tones=tones)


@dataclass(frozen=True, eq=False)
class _Grid:
    """u of the frequencies (m,) of ordinates, and of the lowest one at which a spectrum is evaluated."""

    u: Array
    begin: float
    nyquist: float = inf

    def pieces(self, ordinates: int) -> int:
        """Pieces of a curve through so many ordinates."""
        return int(np.clip(ordinates // 8, 4, MAX_PIECES if self.nyquist == inf else 2 * MAX_PIECES))

    def knots(self, pieces: int) -> Array:
        """Knots of so many pieces from the lowest to the highest frequency."""
        inner = np.linspace(self.begin, self.u.max() + 1e-9, pieces + 1)
        step = inner[1] - inner[0]
        return np.concatenate([inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)])

    def basis(self, pieces: int) -> Array:
        """Values (m, j) of the basis functions, computed once."""
        if pieces not in self._bases:
            self._bases[pieces] = basis_matrix(self.u, self.knots(pieces), 3)
        return self._bases[pieces]

    @cached_property
    def _bases(self) -> dict[int, Array]:
        return {}


def _penalised_spline(
    grid: _Grid, ordinates: Array, use: NDArray[np.bool_], shape: float
) -> tuple[PowerSpectrum, Array]:
    """The curve of least Akaike criterion, and its values (m,) at the frequencies.

    With knots h apart the curvature of a cubic spline is D c / h², D second differences of its coefficients c, so that
    the integral of its square over u is |D c|² / h³.
    """
    power = ordinates[use]
    pieces = grid.pieces(len(power))
    knots, whole = grid.knots(pieces), grid.basis(pieces)
    step, basis = knots[1] - knots[0], whole[use]
    gram, second = basis.T @ basis, np.diff(np.eye(basis.shape[1]), 2, axis=0)
    best: tuple[float, Array, Array, float] | None = None
    for curvature in CURVATURE_PRIORS:
        penalty = second.T @ second / (curvature**2 * step**3)
        covariance = np.linalg.inv(shape * gram + penalty)
        coefficients = _fisher_scoring(basis, power, covariance, penalty, shape)
        freedom = float(np.sum(covariance * (shape * gram)))
        log_power = basis @ coefficients
        criterion = 2 * shape * float(np.sum(log_power + power * np.exp(-log_power))) + 2 * freedom
        if best is None or criterion < best[0]:
            best = (criterion, coefficients, covariance, freedom)
    assert best is not None
    curve = PowerSpectrum(knots, best[1], best[2], ~use, best[3], float(grid.u.min()), grid.nyquist)
    return curve, np.exp(whole @ curve.coefficients)


def _fisher_scoring(basis: Array, power: Array, covariance: Array, penalty: Array, shape: float) -> Array:
    """Coefficients of the largest penalised likelihood, `covariance` the inverse of the penalised information.

    They start at the penalised least squares of the logarithms, corrected for their mean with shape 1.
    """
    coefficients = covariance @ (shape * basis.T @ (np.log(power) + EULER))
    for _ in range(30):
        log_power = basis @ coefficients
        gradient = shape * basis.T @ (power * np.exp(-log_power) - 1) - penalty @ coefficients
        step = covariance @ gradient
        step *= min(1.0, 2.0 / (np.abs(step).max() + 1e-12))
        coefficients = coefficients + step
        if np.abs(step).max() < 1e-8:
            break
    return np.asarray(coefficients)
