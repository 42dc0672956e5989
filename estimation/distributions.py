"""Tail probabilities and quantiles of test distributions, by `scipy.special`.

It loads ten times as fast as `scipy.stats`, and here only with the first call.
`sf` is the survival function P(X > x), `isf` its inverse, as `scipy.stats` calls them; arrays broadcast.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = Any
"""A number, or an array of them."""
QUANTILES = 50
"""Of a distribution over which another is averaged."""
NONCENTRALITY_TOLERANCE = 1e-3
"""Relative, of a noncentrality found by bisection: half as much of an amount."""
NEWTON_TOLERANCE = 1e-8
"""Relative to x: convergence is quadratic, so the step after one this short is below rounding."""


def chi2_sf(statistic: Numbers, freedom: Numbers) -> Numbers:
    """P(X > statistic) of chi-square with `freedom` degrees of freedom."""
    return scipy.special.chdtrc(freedom, statistic)


def chi2_isf(probability: Numbers, freedom: Numbers) -> Numbers:
    """The value that chi-square exceeds with that probability."""
    return scipy.special.chdtri(freedom, probability)


def noncentrality(statistic: Numbers, freedom: Numbers, probability: Numbers) -> Numbers:
    """The noncentrality with which noncentral chi-square exceeds `statistic` with that probability."""
    return scipy.special.chndtrinc(statistic, freedom, 1.0 - probability)


def f_sf(ratio: Numbers, above: Numbers, below: Numbers) -> Numbers:
    """P(X > ratio) of Fisher's F with `above` (numerator) and `below` (denominator) degrees of freedom."""
    return scipy.special.fdtrc(above, below, ratio)


def f_isf(probability: Numbers, above: Numbers, below: Numbers) -> Numbers:
    """The value that Fisher's F exceeds with that probability, accurate for small ones."""
    share = scipy.special.betaincinv(np.asarray(below) / 2, np.asarray(above) / 2, probability)
    return below * (1.0 / np.maximum(share, np.finfo(float).tiny) - 1.0) / above


def f_noncentrality(ratio: Array, above: Array, below: Array, probability: float) -> Array:
    """The noncentrality (t, n) with which noncentral F exceeds each `ratio` (t, n) with that probability.

    The numerator has `above` (t, 1) degrees of freedom, one for each of t tests, the denominator `below` (n,). Averaged
    over quantiles of the denominator; the numerator, noncentral chi-square, by the cube root that is nearly normal
    (Abdel-Aty, Biometrika 41, 1954), which holds at any noncentrality.
    """
    middles = (np.arange(QUANTILES) + 0.5) / QUANTILES
    quantiles = 2 * scipy.special.gammaincinv(below[:, None] / 2, middles) / below[:, None]
    needed, above = (above * ratio)[..., None] * quantiles, above[..., None]
    low, high = np.full(ratio.shape, -10.0), np.log(above[..., 0] * (ratio + 1)) + 10.0
    while (high - low).max() > NONCENTRALITY_TOLERANCE:
        middle = (low + high) / 2
        mean = above + np.exp(middle)[..., None]
        spread = 2 * (2 * mean - above) / (9 * mean**2)
        power = scipy.special.ndtr((1 - spread - np.cbrt(needed / mean)) / np.sqrt(spread)).mean(axis=-1)
        low, high = np.where(power < probability, middle, low), np.where(power < probability, high, middle)
    return np.asarray(np.exp((low + high) / 2))


def gamma_isf(probability: Numbers, shape: Numbers) -> Numbers:
    """The value that a Gamma variable of unit scale exceeds with that probability."""
    return scipy.special.gammainccinv(shape, probability)


def normal_cdf(value: Numbers) -> Numbers:
    """P(X < value) of the standard normal."""
    return scipy.special.ndtr(value)


def normal_isf(probability: Numbers) -> Numbers:
    """The value that a standard normal exceeds with that probability."""
    return -scipy.special.ndtri(probability)


def student_sf(value: Numbers, freedom: Numbers) -> Numbers:
    """P(X > value) of Student's t."""
    return scipy.special.stdtr(freedom, -np.asarray(value))


def student_isf(probability: Numbers, freedom: Numbers) -> Numbers:
    """The value that Student's t exceeds with that probability."""
    return -scipy.special.stdtrit(freedom, probability)


def chi_square_p_value(statistic: Numbers, degrees_of_freedom: float, log_power_variance: float) -> Numbers:
    """P-value of a chi-square statistic, by F where the noise power is itself estimated.

    `log_power_variance` is the variance of the estimated log power spectral density: trigamma(d / 2) for an estimate
    with d degrees of freedom.
    """
    if log_power_variance <= 0:
        return chi2_sf(statistic, degrees_of_freedom)
    return f_sf(statistic / degrees_of_freedom, degrees_of_freedom, 2 * inverse_trigamma(log_power_variance))


def inverse_trigamma(value: float) -> float:
    """The x > 0 at which trigamma(x) = scipy.special.zeta(2, x) has this value.

    By Newton's method on 1 / trigamma, which is convex and nearly linear: from 1/2 + 1 / value it decreases to x
    monotonically (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004, appendix).
    """
    x, step = 0.5 + 1 / value, np.inf
    while step > NEWTON_TOLERANCE * x:
        trigamma = scipy.special.zeta(2, x)
        step = trigamma * (1 - trigamma / value) / (2 * scipy.special.zeta(3, x))
        x -= step
    return float(x)


def binomial_sf(count: int, total: int, probability: float) -> float:
    """P(X >= count) of so many trials with that probability each."""
    return 1.0 if count <= 0 else float(scipy.special.betainc(count, total - count + 1, probability))


def binomial_interval(count: int, total: int, level: float) -> tuple[float, float]:
    """Exact two-sided confidence interval of the probability (Clopper and Pearson, 1934)."""
    tail = (1.0 - level) / 2.0
    low = 0.0 if count == 0 else float(scipy.special.betaincinv(count, total - count + 1, tail))
    high = 1.0 if count == total else float(scipy.special.betaincinv(count + 1, total - count, 1.0 - tail))
    return low, high
