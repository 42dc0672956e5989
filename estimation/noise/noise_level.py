"""Power of noise where a score comes from, as far as its spectrum is known: the p-value of a score in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi_square_p_value

Array = NDArray[np.float64]

BINS = 128
"""Values by which the distribution of a sum is approximated."""
NEGLIGIBLE = 1e-12
"""Probability of values that are left out."""


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """Power of the whitened noise along a direction: `known`, and independent uncertain parts.

    known         what is known of it, in units of the power that whitening took it for
    parts         values (s,) and probabilities (s,) of each part
    log_variance  variance of the log of all of it that is uncertain beside, as that of spectra estimated by repeats
    """

    known: float = 1.0
    parts: tuple[tuple[Array, Array], ...] = ()
    log_variance: float = 0.0

    def and_known(self, power: float, log_variance: float) -> NoiseLevel:
        """With a known power of another recording, and the variance of the log of all that it adds."""
        return NoiseLevel(self.known + float(power), self.parts, self.log_variance + float(log_variance))

    def and_parts(self, power: Array, probability: Array, log_variance: float) -> NoiseLevel:
        """With uncertain powers (p, s) of a recording's channels, their probabilities (p, s), and that variance."""
        parts = (*self.parts, *zip(power, probability, strict=True))
        return NoiseLevel(self.known, parts, self.log_variance + float(log_variance))

    @cached_property
    def mean(self) -> float:
        """Expectation of the power."""
        return self.known + sum(float(values @ probability) for values, probability in self.parts)

    @cached_property
    def variance_of_log(self) -> float:
        """Variance of the log of the power, to first order."""
        variance = sum(float((v - v @ p) ** 2 @ p) for v, p in self.parts)
        return self.log_variance + (variance / self.mean**2 if self.mean > 0 else 0.0)

    def p_value(self, score: float, rank: int) -> float:
        """P-value of a score of so many degrees of freedom in this noise, its expectation over the power."""
        values, probability = self._distribution
        return float(probability @ chi_square_p_value(score / np.maximum(values, 1e-300), rank, self.log_variance))

    @cached_property
    def _distribution(self) -> tuple[Array, Array]:
        """Values and probabilities of the sum of all parts."""
        values, probability = np.array([self.known]), np.ones(1)
        for part, chance in self.parts:
            likely = chance > NEGLIGIBLE * chance.max()
            values = (values[:, None] + part[likely]).ravel()
            probability = (probability[:, None] * chance[likely]).ravel()
            values, probability = _binned(values, probability)
        return values, probability / probability.sum()


def _binned(values: Array, probability: Array) -> tuple[Array, Array]:
    """A distribution of many values by that of the means over bins of equal ratio."""
    low, high = float(values.min()), float(values.max())
    if len(values) <= BINS:
        return values, probability
    if high <= low:  # of parts without power
        return values[:1], probability.sum(keepdims=True)
    low = max(low, NEGLIGIBLE * high)
    ratio = np.log(np.maximum(values, low) / low) / np.log(high / low)
    bins = np.minimum((BINS * ratio).astype(np.intp), BINS - 1)
    total, mean = (np.bincount(bins, weights, BINS) for weights in (probability, probability * values))
    kept = total > 0
    return np.asarray(mean[kept] / total[kept]), np.asarray(total[kept])
