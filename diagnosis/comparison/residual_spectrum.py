"""Spectrum of a single run's residual: what is more in the band of the motion than noise would be.

Without repeats noise and physics look alike. Noise of sensors is white, rises as 1/f towards low frequencies, or comes
out of a filter of first order, whose flank falls as 1/f². Physics that the model lacks follows the motion: its spectrum
ends with that of the motion, and falls faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.distributions import f_sf
from estimation.multiplicity import bonferroni_p_value

Array = NDArray[np.float64]

STEEPEST_NOISE = 2.0
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
        flat = power * np.arange(len(power)) ** STEEPEST_NOISE
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
