"""A smooth power spectrum through periodogram ordinates, robust against single tones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import gamma_isf
from estimation.regression_spline import basis_matrix
from modeling.errors import InputError

Array = NDArray[np.float64]

FEWEST = 8
"""Ordinates below which a curve of four free coefficients and its smoothness cannot be told apart."""
TONE_PROBABILITY = 0.01
"""Chance that an untroubled record loses one ordinate to the search for tones."""


BENDS = (1.0, 0.5)
"""Standard deviations, a priori, of d² log S / d log f² over a unit of log f, from which Akaike's criterion chooses.
A first-order corner bends by 1 at the most, 1/f noise that meets a white floor by 1/4: a stiffer curve would not
follow it to the few lines where drift is judged, whatever the many lines above say."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """log S as a penalised cubic spline in log f: S(f) in the square of the signal's unit, per sample.

    tones   which of the ordinates it was fitted to stand out as lines of their own
    freedom effective number of parameters of the curve
    lowest  log f of the lowest ordinate; below it the curve goes on as straight as the penalty makes it
    """

    knots: Array
    coefficients: Array
    covariance: Array
    tones: NDArray[np.bool_]
    freedom: float
    lowest: float

    def __call__(self, frequency: Array) -> Array:
        """S at positive frequencies; below the ordinates never less than at the lowest.

        Noise that falls towards zero frequency would make drift look certain; a curve's end is not proof of it.
        """
        u = np.log(frequency)
        end = float(self._rows(np.array([self.lowest]))[0] @ self.coefficients)
        curve = self._rows(u) @ self.coefficients
        return np.asarray(np.exp(np.where(u < self.lowest, np.maximum(curve, end), curve)))

    def doubt(self, frequency: Array) -> Array:
        """Variance of log S at these frequencies, a posteriori; it grows where the curve is continued."""
        rows = self._rows(np.log(frequency))
        return np.asarray(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))

    def joint_doubt(self, frequency: Array, shares: Array) -> Array:
        """Variance (g,) of the mean of log S over frequencies (m,) with the weights `shares` (m, g)."""
        return self.joint_doubt_at(self.basis(frequency), shares)

    def basis(self, frequency: Array) -> Array:
        """Values (m, j) of the curve's j basis functions at frequencies (m,)."""
        return self._rows(np.log(frequency))

    def joint_doubt_at(self, basis: Array, shares: Array) -> Array:
        """`joint_doubt` where the basis functions are known already."""
        loads = basis.T @ shares
        return np.asarray(((self.covariance @ loads) * loads).sum(axis=0))

    def _rows(self, u: Array) -> Array:
        """Basis values at log f, held at the ends."""
        low, high = self.knots[3], self.knots[-4]
        return basis_matrix(np.clip(u, low, high), self.knots, 3)


def smooth_spectrum(frequency: Array, ordinates: Array, *, shape: float = 1.0, start: float | None = None) -> Spectrum:
    """Fit log S(f) to periodogram ordinates by penalised Whittle likelihood.

    frequency  (m,) positive; ordinates (m,) with mean S(f), distributed as Gamma of the given shape (1 for a single
    periodogram, R-1 for an average over R-1 differences); `start` the lowest frequency at which S will be asked for.
    With the log link the Fisher information of each ordinate is `shape` whatever S, so that each scoring step is one
    penalised least-squares solve; the penalty on the bend is chosen by Akaike's criterion. Ordinates that no Gamma
    variable of their number would reach are taken as tones, with their neighbours, and left out.
    """
    begin = float(frequency.min()) if start is None else min(start, float(frequency.min()))
    keep = np.isfinite(ordinates) & (ordinates > 0)
    if keep.sum() < FEWEST:
        raise InputError(
            what="a channel's noise has too few lines to be judged by",
            where="recording",
            remedy="record longer, or the raw sensor instead of rounded readings",
        )
    tones = ~keep
    for _ in range(4):
        curve = _fitted(frequency, ordinates, ~tones, shape, begin)
        limit = gamma_isf(TONE_PROBABILITY / len(frequency), shape) / shape
        loud = keep & (ordinates > limit * curve(frequency))
        found = tones | loud | np.roll(loud, 1) | np.roll(loud, -1)
        if (found == tones).all() or found.mean() > 0.3:
            break
        tones = found
    return replace(curve, tones=tones)


def _fitted(frequency: Array, ordinates: Array, use: NDArray[np.bool_], shape: float, begin: float) -> Spectrum:
    """The curve of least Akaike criterion. With knots h apart the bend of a cubic spline is D c / h², D second
    differences of its coefficients c, so that the integral of its square over log f is |D c|² / h³."""
    u, power = np.log(frequency), ordinates[use]
    pieces = int(np.clip(len(power) // 8, 4, 24))
    inner = np.linspace(np.log(begin), u.max() + 1e-9, pieces + 1)
    step = inner[1] - inner[0]
    knots = np.concatenate([inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)])
    basis = basis_matrix(u[use], knots, 3)
    gram, second = basis.T @ basis, np.diff(np.eye(basis.shape[1]), 2, axis=0)
    best: tuple[float, Array, Array, float] | None = None
    for bend in BENDS:
        penalty = second.T @ second / (bend**2 * step**3)
        normal = shape * gram + penalty
        coefficients = _scored(basis, power, normal, penalty, shape)
        freedom = float(np.trace(np.linalg.solve(normal, shape * gram)))
        log_power = basis @ coefficients
        criterion = 2 * shape * float(np.sum(log_power + power * np.exp(-log_power))) + 2 * freedom
        if best is None or criterion < best[0]:
            best = (criterion, coefficients, np.linalg.inv(normal), freedom)
    assert best is not None
    return Spectrum(knots, best[1], best[2], ~use, best[3], float(u.min()))


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
