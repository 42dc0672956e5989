"""Scatter: how estimates from many recordings of one motion lie, against the information that it promised.

With n recordings the scatter S of k estimates about their mean is Wishart, (n-1) S ~ W(n-1, M^-1), if the promise is
true. So of each variance (n-1) S_ii / (M^-1)_ii is chi-square of n-1, (n-1) tr(M S) is chi-square of (n-1) k, and
ln det(M S) is a sum of logarithms of chi-squares of n-1 .. n-k (Bartlett), taken as normal with its mean and variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import polygamma, psi
from scipy.stats import chi2, norm

Array = npt.NDArray[np.float64]
Interval = tuple[float, float]

LEVEL = 0.95
TAIL = (1 - LEVEL) / 2


@dataclass(frozen=True, eq=False)
class Scatter:
    """Estimates theta (n, k) along a motion, and the information M (k, k) that was promised."""

    name: str
    theta: Array
    information: Array

    @property
    def freedom(self) -> int:
        """n - 1."""
        return len(self.theta) - 1

    @cached_property
    def measured(self) -> Array:
        """S (k, k)."""
        return np.asarray(np.cov(self.theta.T), dtype=float)

    @cached_property
    def promise(self) -> Array:
        """M^-1 (k, k)."""
        return np.asarray(np.linalg.inv(self.information), dtype=float)

    @property
    def variance(self) -> Array:
        """Measured over promised variance of each parameter, (k,)."""
        return np.asarray(np.diag(self.measured) / np.diag(self.promise))

    @property
    def variance_interval(self) -> Interval:
        """Where each of them lies if the promise is true."""
        return _chi_square(self.freedom)

    @property
    def trace(self) -> float:
        """tr(M S) / k: the mean over all directions of measured over promised variance."""
        return float(np.trace(self.information @ self.measured)) / len(self.information)

    @property
    def trace_interval(self) -> Interval:
        """Where it lies if the promise is true."""
        return _chi_square(self.freedom * len(self.information))

    @property
    def logdet(self) -> float:
        """ln det(M S): how much larger the ellipsoid is than promised, twice the logarithm of its volume."""
        return float(np.linalg.slogdet(self.information)[1] + np.linalg.slogdet(self.measured)[1])

    @property
    def logdet_interval(self) -> Interval:
        """Where it lies if the promise is true: sum_i ln chi²(n - i) - k ln(n - 1)."""
        half = (self.freedom - np.arange(len(self.information))) / 2
        mean = float((psi(half) + np.log(2 / self.freedom)).sum())
        reach = float(norm.ppf(1 - TAIL) * np.sqrt(polygamma(1, half).sum()))
        return mean - reach, mean + reach

    def row(self) -> tuple[str, ...]:
        """ln det(M S), tr(M S)/k, and the extreme variances, with their intervals."""
        extremes = f"{self.variance.min():.2f} .. {self.variance.max():.2f} ({span(self.variance_interval)})"
        logdet = f"{self.logdet:+.2f} ({span(self.logdet_interval)})"
        return (self.name, logdet, f"{self.trace:.3f} ({span(self.trace_interval)})", extremes)


def _chi_square(freedom: int, tail: float = TAIL) -> Interval:
    """Where a chi-square over its freedom lies."""
    return float(chi2.ppf(tail, freedom)) / freedom, float(chi2.ppf(1 - tail, freedom)) / freedom


def span(interval: Interval) -> str:
    """From and to."""
    return " .. ".join(f"{end:.3g}" for end in interval)
