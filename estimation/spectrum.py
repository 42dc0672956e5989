"""A smooth power spectrum through periodogram ordinates, robust against single tones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.stats import gamma

Array = NDArray[np.float64]

TONE_PROBABILITY = 0.01
"""Chance that an untroubled record loses one ordinate to the search for tones."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """log S as a penalised cubic spline in log f: S(f) in the square of the signal's unit, per sample.

    tones   which of the ordinates it was fitted to stand out as lines of their own
    freedom effective number of parameters of the curve
    """

    knots: Array
    coefficients: Array
    covariance: Array
    tones: NDArray[np.bool_]
    freedom: float

    def __call__(self, frequency: Array) -> Array:
        """S at positive frequencies; below the ordinates the curve goes on straight in log-log, never falling.

        Noise that falls towards zero frequency would make drift look certain; a curve's end is not proof of it.
        """
        rows, steep = self._rows(frequency)
        slope = float(steep @ self.coefficients)
        beyond = self._beyond(frequency)
        return np.asarray(np.exp(rows @ self.coefficients + beyond * min(0.0, slope)))

    def doubt(self, frequency: Array) -> Array:
        """Variance of log S at these frequencies, from the curve's own fit; it grows where the curve is continued."""
        rows, steep = self._rows(frequency)
        rows = rows + self._beyond(frequency)[:, None] * steep
        return np.asarray(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))

    def _beyond(self, frequency: Array) -> Array:
        """How far in log f each frequency lies below the curve's own range, negative."""
        return np.asarray(np.minimum(np.log(frequency) - self.knots[3], 0.0))

    def _rows(self, frequency: Array) -> tuple[Array, Array]:
        """Basis values at the frequencies, held at the ends, and the slope of each basis function at the low end."""
        low, high = self.knots[3], self.knots[-4]
        inside = np.clip(np.log(frequency), low, np.nextafter(high, low))
        size = len(self.coefficients)
        steep = np.array([BSpline(self.knots, unit, 3).derivative()(low) for unit in np.eye(size)])
        return BSpline.design_matrix(inside, self.knots, 3).toarray(), steep


def smooth_spectrum(frequency: Array, ordinates: Array, *, shape: float = 1.0) -> Spectrum:
    """Fit log S(f) to periodogram ordinates by penalised Whittle likelihood.

    frequency  (m,) positive; ordinates (m,) with mean S(f), distributed as Gamma of the given shape (1 for a single
    periodogram, R-1 for an average over R-1 differences). With the log link the Fisher information of each ordinate
    is `shape` whatever S, so that each scoring step is one penalised least-squares solve; the penalty on second
    differences is chosen by Akaike's criterion. Ordinates that no Gamma variable of their number would reach are
    taken as tones, with their neighbours, and left out.
    """
    keep = np.isfinite(ordinates) & (ordinates > 0)
    tones = ~keep
    for _ in range(4):
        curve = _fitted(frequency, ordinates, ~tones, shape)
        limit = gamma.isf(TONE_PROBABILITY / len(frequency), shape) / shape
        loud = keep & (ordinates > limit * curve(frequency))
        found = tones | loud | np.roll(loud, 1) | np.roll(loud, -1)
        if (found == tones).all() or found.mean() > 0.3:
            break
        tones = found
    return Spectrum(curve.knots, curve.coefficients, curve.covariance, tones, curve.freedom)


def _fitted(frequency: Array, ordinates: Array, use: NDArray[np.bool_], shape: float) -> Spectrum:
    u, power = np.log(frequency), ordinates[use]
    pieces = int(np.clip(len(power) // 8, 4, 24))
    inner = np.linspace(u.min(), u.max() + 1e-9, pieces + 1)
    step = inner[1] - inner[0]
    knots = np.concatenate([inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)])
    basis = BSpline.design_matrix(u[use], knots, 3).toarray()
    gram, second = basis.T @ basis, np.diff(np.eye(basis.shape[1]), 2, axis=0)
    best: tuple[float, Array, Array, float] | None = None
    for penalty in 10.0 ** np.arange(-1, 6):
        normal = shape * gram + penalty * second.T @ second
        coefficients = _scored(basis, power, normal, penalty * second.T @ second, shape)
        freedom = float(np.trace(np.linalg.solve(normal, shape * gram)))
        log_power = basis @ coefficients
        criterion = 2 * shape * float(np.sum(log_power + power * np.exp(-log_power))) + 2 * freedom
        if best is None or criterion < best[0]:
            best = (criterion, coefficients, np.linalg.inv(normal), freedom)
    assert best is not None
    return Spectrum(knots, best[1], best[2], ~use, best[3])


def _scored(basis: Array, power: Array, normal: Array, penalty: Array, shape: float) -> Array:
    coefficients = np.linalg.lstsq(
        basis.T @ basis + 1e-6 * np.eye(basis.shape[1]) + penalty,
        basis.T @ np.log(power) + basis.T @ np.full(len(power), 0.5772),
        rcond=None,
    )[0]
    for _ in range(30):
        log_power = basis @ coefficients
        gradient = shape * basis.T @ (power * np.exp(-log_power) - 1) - penalty @ coefficients
        step = np.linalg.solve(normal, gradient)
        step *= min(1.0, 2.0 / (np.abs(step).max() + 1e-12))
        coefficients = coefficients + step
        if np.abs(step).max() < 1e-8:
            break
    return np.asarray(coefficients)
