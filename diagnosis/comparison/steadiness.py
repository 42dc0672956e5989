"""Whether a single run's residual is steady, as the noise of a sensor is, or comes and goes.

Noise of a sensor is Gaussian, of any colour, and the same throughout. A part that knocks, a gear whose ripple runs
through the frequencies with its speed, or vibration that starts with the motion leave impulses in the whitened
residual, squares of it that are correlated, or octaves of it whose power varies, whatever the spectrum of the whole
looks like. It is whitened by an autoregression, which follows a resonance or a low-pass filter, as a smooth curve in
log-log axes does not, and whose innovations have no leakage from the record's ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from estimation.autoregression import fit_autoregression
from estimation.multiplicity import bonferroni_p_value, chi2_isf, chi2_sf, f_sf, normal_cdf

# Spectrum of a single run's residual: what is more in the band of the motion than noise would be.
#
# Without repeats noise and physics look alike. Noise of sensors is white, rises as 1/f towards low frequencies, or
# comes out of a filter of first order, whose flank falls as 1/f². Physics that the model lacks follows the motion: its
# spectrum ends with that of the motion, and falls faster.


Array = NDArray[np.float64]

STEEPEST_FALL = 2.0
"""Power of 1/frequency with which the spectrum of noise falls at the most, over an octave or more."""
FLICKER = 1.0
"""The same of noise that every sensor has."""
OCTAVES_APART = (1, 2)
"""Between two octaves whose levels are compared: one where the motion's spectrum ends sharply, two where its flank
is wider. More would take the flank of a sensor's own filter for physics."""
FIRST_LINE = 8
"""Of the lowest octave: fewer lines have no level of their own."""
PER_OCTAVE = 2
"""Octaves begin, to an octave."""
OUTLYING_SHARE, OUTLYING_LINES = 0.1, 2
"""Of the low octave's lines, the largest that do not count: a tone is no motion."""
MOTION_POWER = 0.999
"""Of the predicted readings, up to the highest line of the motion's band."""
LARGEST_BAND = 1 / 8
"""Of all lines: above a motion that fills more, too few lines show the noise."""


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Power (n, p) of the residual at the lines 0 .. n - 1 of a cosine transform, and the motion's highest line."""

    power: Array
    band: int

    @classmethod
    def of(cls, residual: Array, predicted: Array) -> ResidualSpectrum:
        """Of a residual and the predicted readings, both (n, p)."""
        return cls(dct(residual, axis=0, norm="ortho") ** 2, motion_band(predicted))

    @property
    def reach(self) -> int:
        """Highest line of what follows the motion: an octave above its band, as squares and resonances do."""
        return 2 * self.band

    @property
    def noise_variance(self) -> Array:
        """Variance (p,) of one sample of white noise of the level above what follows the motion."""
        return np.asarray(self.power[self.reach + 1 :].mean(axis=0))

    @property
    def band_power(self) -> Array:
        """Variance (p,) in what follows the motion."""
        return np.asarray(self.power[1 : self.reach + 1].sum(axis=0) / len(self.power))

    @property
    def band_excess(self) -> Array:
        """Variance (p,) of the residual in what follows the motion in excess of white noise as above it."""
        lines = min(self.reach, len(self.power) - 1)
        return np.asarray(np.maximum(self.band_power - lines * self.noise_variance / len(self.power), 0.0))

    @property
    def beyond_flicker_noise(self) -> Array:
        """Variance (p,) of the residual in the motion's band in excess of 1/f noise from its upper end on."""
        low = self.power[1 : self.band + 1]
        noise = self.noise_variance * (self.band / np.arange(1, self.band + 1)[:, None]) ** FLICKER
        return np.asarray(np.maximum((low - noise).sum(axis=0), 0.0) / len(self.power))

    @property
    def steepness_p_values(self) -> Array:
        """P-values (p,) of "the spectrum nowhere in the motion's band falls faster than noise".

        The mean of power times frequency² in each octave in the band is compared by F with that one and two octaves
        above, without the largest lines of the lower octave; Bonferroni over the pairs.
        """
        return np.array([bonferroni_p_value(self._p_values(column)) for column in self.power.T])

    def _p_values(self, power: Array) -> list[float]:
        flat = power * np.arange(len(power)) ** STEEPEST_FALL
        starts = FIRST_LINE * 2.0 ** (np.arange(32 * PER_OCTAVE) / PER_OCTAVE)
        p_values = [1.0]
        for low in starts[2 * starts <= self.band + 1]:
            below = np.sort(flat[int(low) : int(2 * low)])
            count = len(below) - int(OUTLYING_SHARE * len(below)) - OUTLYING_LINES
            for first in (low * 2**apart for apart in OCTAVES_APART):
                above = flat[int(first) : int(2 * first)]
                ratio = float(below[:count].mean() / max(above.mean(), 1e-300))
                p_values.append(f_sf(ratio, count, len(above)))
        return p_values

    @property
    def variance(self) -> Array:
        """Variance (p,) of the residual about its mean."""
        return np.asarray(self.power[1:].sum(axis=0) / len(self.power))

    @property
    def upper_noise(self) -> Array:
        """Variance (p,) of one sample of white noise of the level of the upper half of the lines."""
        return np.asarray(self.power[len(self.power) // 2 :].mean(axis=0))


def motion_band(predicted: Array) -> int:
    """Highest line of the band of a tool's motion, from its predicted readings (n, p)."""
    power = dct(predicted, axis=0, norm="ortho")[1:] ** 2
    shares = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), 1e-300)
    highest = 1 + int(np.argmax(shares >= MOTION_POWER, axis=0).max())
    return int(np.clip(highest, 1, max(1.0, LARGEST_BAND * len(predicted))))


LAGS = 20
"""Samples, up to which the correlation of squares is tested."""
OCTAVE = slice(4, 8)
"""Lines of a window's spectrum: an octave, in windows that are shorter the higher it lies."""
OCTAVE_LINES = OCTAVE.stop - OCTAVE.start
QUIET_SHARE = 0.25
"""Of an octave's windows, the quietest, which give the power of steady noise."""
FEWEST_WINDOWS = 24
"""Windows of an octave from which it is looked at."""
SAME_LEVEL = 1e-9
"""Of the range of a channel's readings: values that are nearer are equal but for rounding."""
FLOOR = 0.01
"""Spectral density, over that of white noise of the residual's variance, below which a line is not tested: such lines
have together less than a hundredth of the variance, and what is rounded or is left behind a filter lies there."""


def steadiness_p_values(residual: Array) -> Array:
    """P-values (p,) of "a single run's residual (n, p) is steady Gaussian noise", of whatever spectrum.

    Of the whitened residual the kurtosis (impulses), the correlation of the squares and the power of the octaves are
    tested; Bonferroni. 1 where fewer lines are above `FLOOR` than `FEWEST_WINDOWS` windows of the highest octave have.
    """
    return np.array([_steadiness_p_value(column) for column in residual.T])


def _steadiness_p_value(series: Array) -> float:
    lines = _white_lines(series - series.mean())
    if len(lines) < FEWEST_WINDOWS * OCTAVE.stop:
        return 1.0
    rows = np.asarray(idct(lines, norm="ortho"))
    return bonferroni_p_value([test(rows) for test in (kurtosis_p_value, squares_p_value, octaves_p_value)])


def _white_lines(series: Array) -> Array:
    """Cosine lines (m,) of the innovations of a series (n,), those at which its spectrum is above `FLOOR`.

    Closed up and transformed back they are m rows, white if the innovations are, and in the order of time: a shift of
    the lines modulates a row and does not move it.
    """
    noise = fit_autoregression(series[:, None], np.ones(len(series), dtype=bool))
    innovations = noise.innovations(series[None])[0]
    filtered = np.fft.rfft(np.append(1.0, -noise.coefficients[:, 0]), 2 * len(innovations))[:-1]
    power = noise.covariance[0, 0] / np.maximum(np.abs(filtered) ** 2, 1e-300)
    return np.asarray(dct(innovations, norm="ortho")[power >= FLOOR * series.var()])


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


def octaves_p_value(rows: Array) -> float:
    """P-value of "independent normal rows (n,) have the same power in all windows", in every octave; Bonferroni.

    By the test of M. S. Bartlett (Proc. R. Soc. A 160, 1937, 268-282), with the freedom of an octave's lines a window.
    1 where the rows are too few for `FEWEST_WINDOWS` windows.
    """
    powers = [(lines[:, :, 0] ** 2).mean(axis=1) for _, lines in _octaves(rows[:, None])]
    return bonferroni_p_value([_bartlett_p_value(power) for power in powers])


def _bartlett_p_value(power: Array) -> float:
    """P-value of one variance in all windows, from their mean squares (windows,) of `OCTAVE_LINES` normal values."""
    windows, power = len(power), np.maximum(power, 1e-300)
    statistic = OCTAVE_LINES * windows * (np.log(power.mean()) - np.log(power).mean())
    return float(chi2_sf(statistic / (1 + (windows + 1) / (3 * windows * OCTAVE_LINES)), windows - 1))


def unsteady_variance(residual: Array) -> tuple[Array, Array]:
    """Variance (p,) of a residual (n, p) that comes and goes, and that of the steady noise beside it.

    In each octave the quietest windows show the level of the steady noise; the mean exceeds it by what comes and goes.
    Octaves that are too low for `FEWEST_WINDOWS` windows are in neither. Both are sizes and no test: a resonance that
    rings through many windows comes and goes by chance, which `steadiness_p_values` tells from other causes.
    """
    unsteady, steady = np.zeros((2, residual.shape[1]))
    for length, lines in _octaves(residual):
        freedom, power = _independent_lines(lines), (lines**2).mean(axis=1)
        quantile = chi2_isf(1 - QUIET_SHARE, freedom) / freedom
        quiet, mean = np.quantile(power, QUIET_SHARE, axis=0) / quantile, power.mean(axis=0)
        steady += np.minimum(quiet, mean) * OCTAVE_LINES / length
        unsteady += np.maximum(mean - quiet, 0.0) * OCTAVE_LINES / length
    return unsteady, steady


def _octaves(residual: Array) -> Iterator[tuple[int, Array]]:
    """Length of the windows, which are beside each other, and lines (windows, `OCTAVE_LINES`, p), octave by octave."""
    length = OCTAVE.stop
    while length * FEWEST_WINDOWS <= len(residual):
        windows = len(residual) // length
        start = (len(residual) - windows * length) // 2
        parts = residual[start : start + windows * length].reshape(windows, length, -1)
        yield length, np.asarray(dct(parts, axis=1, norm="ortho")[:, OCTAVE])
        length *= 2


def level_spacing(readings: Array) -> Array:
    """Least spacing (p,) between the values of readings (n, p): that of the levels where they are rounded."""
    spacings = []
    for column in readings.T:
        steps = np.diff(np.unique(column))
        apart = steps[steps > SAME_LEVEL * np.ptp(column)]
        spacings.append(float(apart.min(initial=np.inf)) if len(apart) else 0.0)
    return np.array(spacings)


def _independent_lines(lines: Array) -> Array:
    """Effective number (p,) of independent lines of equal power among an octave's (windows, `OCTAVE_LINES`, p).

    1 over the sum of C_kl² (Satterthwaite), C the mean product of the lines of windows scaled to unit power, so that
    loud windows count no more than quiet ones. The sum is without the bias 1 / windows that unit vectors have in it.
    """
    unit = lines / np.maximum(np.sqrt((lines**2).sum(axis=1, keepdims=True)), 1e-150)
    product = np.einsum("wkp,wlp->klp", unit, unit) / len(lines)
    squared = (len(lines) * (product**2).sum(axis=(0, 1)) - 1) / (len(lines) - 1)
    return np.asarray(np.clip(1 / np.maximum(squared, 1e-300), 1.0, OCTAVE_LINES))
