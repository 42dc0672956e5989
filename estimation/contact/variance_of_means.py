"""Variance of means of coloured noise, from an autoregression or from differences of successive means."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_isf, normal_isf
from estimation.noise.disturbances.transient_windows import cumulative_sums, variances_of_sums
from modeling.noise.autoregressive_noise import NoiseModel

Array = NDArray[np.float64]

NORMAL_QUARTILE = float(normal_isf(0.375))
"""Lower quartile of the absolute value of a standard normal variable."""
MIN_DIFFERENCES = 4
"""Least number of independent differences that the power at a scale is estimated from."""


@dataclass(frozen=True, eq=False)
class VarianceOfMeans:
    """Covariance of means over 1 .. n successive samples of stationary noise with p channels.

    variance     (n, p): of the mean over 1, 2, .. n samples of each channel
    correlation  (p, p) between the channels, assumed the same for all means
    constant     (p,) variance that averaging does not reduce: the model's systematic residual
    """

    variance: Array
    correlation: Array
    constant: Array

    @classmethod
    def of_autoregression(cls, noise: NoiseModel, longest: int, constant: Array) -> VarianceOfMeans:
        """The means of autoregressive noise over up to `longest` samples."""
        autocovariance, length = noise.autocovariance(longest), np.arange(1, longest + 1)[:, None]
        sums = np.maximum(variances_of_sums(autocovariance), 1e-12 * autocovariance[0] * length)
        scale = np.sqrt(np.diag(noise.covariance))
        return cls(sums / length**2, noise.covariance / np.outer(scale, scale), constant)

    def at_least(self, other: VarianceOfMeans) -> VarianceOfMeans:
        """The larger variance of both for every mean: an autoregression misses the slow part of 1/f noise."""
        return replace(self, variance=np.maximum(self.variance, other.variance))

    def covariance(self, length: int) -> Array:
        """Covariance (p, p) of a mean over `length` samples, the constant part included."""
        scale = np.sqrt(self.variance[length - 1])
        return np.asarray(self.correlation * np.outer(scale, scale) + np.diag(self.constant))


@dataclass(frozen=True, eq=False)
class MeanDifferences:
    """Differences of successive means of a series (n, p) over 1, 2, 4, .. samples; of few those of the scale before.

    power        (s, p) mean square; from their lower quartile unless `quiet`
    independent  (s,) number of independent differences
    quiet        whether they are of samples that are known to be contact-free
    samples      n
    """

    power: Array
    independent: Array
    quiet: bool
    samples: int

    @classmethod
    def of(cls, series: Array, quiet: NDArray[np.bool_] | None = None) -> MeanDifferences:
        """Of the `quiet` (contact-free) samples, or of the quieter part of a series.

        Where quiet samples are unknown the mean square comes from the lower quartile of the absolute differences, which
        a contact in less than three quarters of the record does not affect.
        """
        sums = cumulative_sums(series)
        disturbed = cumulative_sums(np.zeros(len(series)) if quiet is None else (~quiet).astype(float))
        powers, numbers = list[Array](), list[float]()
        for scale in map(int, _scales(len(series))):
            start = np.arange(0, len(series) + 1 - 2 * scale, max(1, scale // 4))
            start = start[disturbed[start + 2 * scale] == disturbed[start]]
            independent = len(start) * max(1, scale // 4) / (2 * scale)
            if powers and independent < MIN_DIFFERENCES:
                powers.append(powers[-1])
                numbers.append(numbers[-1])
                continue
            difference = (sums[start + 2 * scale] - 2 * sums[start + scale] + sums[start]) / scale
            powers.append(_mean_square(difference, robust=quiet is None))
            numbers.append(independent)
        return cls(np.stack(powers), np.array(numbers), quiet is not None, len(series))

    def variance_of_means(self, constant: Array, *, exceedance: float = 0.5) -> VarianceOfMeans:
        """The noise of the series.

        Two successive means over L have half of their sum with the variance V_2L, and half of their difference with
        D_L / 4, so that V_L = V_2L + D_L / 4: V_L is a sum over the scales above (Haar's wavelet variances; Allan's up
        to a factor). No noise model is needed. D_L is the mean square of the differences between means. Few differences
        leave it uncertain: from quiet ones it is the limit that D exceeds with probability `exceedance`, by default its
        median. At the largest scales D is extrapolated as constant, as for 1/f noise.
        """
        scales, powers = _scales(self.samples), self.power
        if self.quiet:
            freedom = np.maximum(self.independent, 1.0)
            powers = powers * np.array([one / chi2_isf(1 - exceedance, one) for one in map(float, freedom)])[:, None]
        levels = np.cumsum(powers[::-1], axis=0)[::-1] / 4 + 1e-300
        length = np.log(np.arange(1, self.samples + 1))
        variance = [np.exp(np.interp(length, np.log(scales), np.log(level))) for level in levels.T]
        return VarianceOfMeans(np.stack(variance, axis=1), np.eye(levels.shape[1]), constant)


def _scales(samples: int) -> NDArray[np.intp]:
    return np.asarray(2 ** np.arange(int(np.log2(max(samples, 2))) + 1), dtype=np.intp)


def _mean_square(difference: Array, *, robust: bool) -> Array:
    """Mean square (p,) of differences, or from their lower quartile."""
    if not len(difference):
        return np.full(difference.shape[1], 1e-300)
    if robust:
        return np.asarray((np.quantile(np.abs(difference), 0.25, axis=0) / NORMAL_QUARTILE) ** 2)
    return np.asarray((difference**2).mean(axis=0))
