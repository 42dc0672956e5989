"""Whether a single run's residual is steady, as the noise of a sensor is, or comes and goes.

Noise of a sensor is Gaussian, of any colour, and the same throughout. A part that knocks, a gear whose ripple runs
through the frequencies with its speed, or vibration that starts with the motion leave impulses in the whitened
residual, or squares of it that are correlated, whatever the spectrum of the whole looks like.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.distributions import chi2_isf, chi2_sf, normal_cdf
from estimation.multiplicity import bonferroni_p_value
from estimation.recordings.recording import Recording
from estimation.robust.outliers import inverse_covariance_filter

Array = NDArray[np.float64]

LAGS = 20
"""Samples, up to which the correlation of squares is tested."""
OCTAVE = slice(4, 8)
"""Lines of a window's spectrum: an octave, in windows that are shorter the higher it lies."""
QUIET_SHARE = 0.25
"""Of an octave's windows, the quietest, which give the power of steady noise."""
FEWEST = 24
"""Windows of an octave from which it is looked at."""


def steadiness_p_values(recording: Recording, residual: Array) -> Array:
    """P-values (p,) of "a single run's residual (n, p) is steady Gaussian noise", of whatever spectrum.

    Of the whitened residual the kurtosis (impulses) and the correlation of the squares are tested; Bonferroni.
    """
    white = inverse_covariance_filter(recording, residual[None]).whitened(residual[None])[0]
    tests = (kurtosis_p_value, squares_p_value)
    return np.array([bonferroni_p_value([test(column) for test in tests]) for column in white.T])


def kurtosis_p_value(rows: Array) -> float:
    """One-sided p-value of "independent normal rows (n,) have no larger kurtosis".

    By the transformation of F. J. Anscombe and W. J. Glynn (Biometrika 70, 1983, 227-234), from 20 rows on.
    """
    n = len(rows)
    centred = rows - rows.mean()
    kurtosis = float((centred**4).mean() / max(float((centred**2).mean()) ** 2, 1e-300))
    variance = 24 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    x = (kurtosis - 3 * (n - 1) / (n + 1)) / np.sqrt(variance)
    skewness = 6 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9)) * np.sqrt(6 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3)))
    a = 6 + 8 / skewness * (2 / skewness + np.sqrt(1 + 4 / skewness**2))
    shrunk = np.cbrt((1 - 2 / a) / (1 + x * np.sqrt(2 / (a - 4))))
    return float(normal_cdf((shrunk - 1 + 2 / (9 * a)) / np.sqrt(2 / (9 * a))))


def squares_p_value(rows: Array) -> float:
    """P-value of "the squares of independent normal rows (n,) are not correlated", up to LAGS.

    A. I. McLeod and W. K. Li, J. Time Ser. Anal. 4 (1983) 269-273.
    """
    n, squares = len(rows), rows**2
    centred = squares - squares.mean()
    power = max(float(centred @ centred), 1e-300)
    lags = np.arange(1, LAGS + 1)
    correlation = np.array([centred[lag:] @ centred[:-lag] for lag in lags]) / power
    return float(chi2_sf(n * (n + 2) * float((correlation**2 / (n - lags)).sum()), LAGS))


def unsteady_variance(residual: Array) -> tuple[Array, Array]:
    """Variance (p,) of a residual (n, p) that comes and goes, and that of the steady noise beside it.

    In each octave the quietest windows show the level of the steady noise; the mean exceeds it by what comes and goes.
    Octaves that are too low for `FEWEST` windows are in neither.
    """
    unsteady, steady = np.zeros((2, residual.shape[1]))
    count = OCTAVE.stop - OCTAVE.start
    quantile = float(chi2_isf(1 - QUIET_SHARE, count)) / count
    length = OCTAVE.stop
    while length * FEWEST <= len(residual):
        power = _octave_power(residual, length)
        quiet, mean = np.quantile(power, QUIET_SHARE, axis=0) / quantile, power.mean(axis=0)
        steady += np.minimum(quiet, mean) * count / length
        unsteady += np.maximum(mean - quiet, 0.0) * count / length
        length *= 2
    return unsteady, steady


def _octave_power(residual: Array, length: int) -> Array:
    """Mean power (windows, p) of an octave's lines in windows of this length, beside each other."""
    windows = len(residual) // length
    start = (len(residual) - windows * length) // 2
    parts = residual[start : start + windows * length].reshape(windows, length, -1)
    return np.asarray((dct(parts, axis=1, norm="ortho")[:, OCTAVE] ** 2).mean(axis=1))
