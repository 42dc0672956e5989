"""Corrections for multiple tests (Bonferroni, Holm, false discovery rate), thresholds and effective number of tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.significance import LEVELS

# Tail probabilities and quantiles of test distributions, by `scipy.special`.
#
# It loads ten times as fast as `scipy.stats`, and here only with the first call. `sf` is the survival function P(X >
# x), `isf` its inverse, as `scipy.stats` calls them; arrays broadcast.


Array = NDArray[np.float64]
Numbers = Any
"""A number, or an array of them."""
QUANTILES = 50
"""Of a distribution over which another is averaged."""
LATTICE = 19
"""Quantiles of two independent distributions are paired by multiples of it, which covers their square evenly."""
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


def f_noncentrality(
    ratio: Array, above: Array, below: Array, probability: float, *, in_other_noise: bool = False
) -> Array:
    """The noncentrality (t, n) with which noncentral F exceeds each `ratio` (t, n) with that probability.

    With `in_other_noise` it is stated in units of another estimate of the noise, of as many degrees of freedom.

    The numerator has `above` (t, 1) degrees of freedom, one for each of t tests, the denominator `below` (n,). Averaged
    over quantiles of the denominator; the numerator, noncentral chi-square, by the cube root that is nearly normal
    (Abdel-Aty, Biometrika 41, 1954), which holds at any noncentrality.
    """
    middles = (np.arange(QUANTILES) + 0.5) / QUANTILES
    quantiles = 2 * scipy.special.gammaincinv(below[:, None] / 2, middles) / below[:, None]
    units = quantiles[:, LATTICE * np.arange(QUANTILES) % QUANTILES] if in_other_noise else 1.0
    needed, above = (above * ratio)[..., None] * quantiles, above[..., None]
    low, high = np.full(ratio.shape, -10.0), np.log(above[..., 0] * (ratio + 1)) + 10.0
    while (high - low).max() > NONCENTRALITY_TOLERANCE:
        middle = (low + high) / 2
        mean = above + np.exp(middle)[..., None] * units
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


def bonferroni_p_value(p_values: Sequence[float]) -> float:
    """Bonferroni-corrected p-value of the most significant of several tests; 1 without any."""
    return float(min(1.0, len(p_values) * min(p_values))) if len(p_values) else 1.0


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """Holm-adjusted p-values, in the order given (Scand. J. Stat. 6, 1979)."""
    adjusted, highest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        highest = max(highest, min(1.0, float((len(p_values) - rank) * p_values[place])))
        adjusted[place] = highest
    return adjusted


def false_discovery_rates(p_values: Array) -> Array:
    """P-values (n,) adjusted for the false discovery rate (Benjamini and Hochberg, J. R. Stat. Soc. B 57, 1995).

    Equal to `scipy.stats.false_discovery_control`, whose import takes longer than drawing all maps.
    """
    order = np.argsort(p_values)[::-1]
    scaled = p_values[order] * len(order) / np.arange(len(order), 0, -1)
    rates = np.empty_like(p_values)
    rates[order] = np.minimum(np.minimum.accumulate(scaled), 1.0)
    return rates


def bonferroni_level(candidates: int) -> float:
    """Bonferroni-corrected significance level of one of several candidate effects: 1 % over their number."""
    return LEVELS.effect / max(1, candidates)


def chi_square_penalty(model: WrenchModel, candidates: int) -> float:
    """Penalty on the whitened chi-square for a model's effects: the sum of their Bonferroni thresholds.

    That of an effect of k free parameters is the chi-square quantile with k degrees of freedom at 1 % over the number
    of candidates, as in the score test.
    """
    free = [sum(not p.fixed for p in effect.parameters(model.space)) for effect in model.effects]
    return sum(bonferroni_threshold(number, candidates) for number in free)


def bonferroni_threshold(parameters: int, candidates: int) -> float:
    """Bonferroni-corrected chi-square threshold for adding one of several candidates with so many parameters."""
    return float(chi2_isf(bonferroni_level(candidates), parameters))


def detectable_noncentrality(freedom: Sequence[int], significance: Sequence[float], log_power_variance: Array) -> Array:
    """Noncentrality (t, n) that each of t score tests detects with 80 % power, in recordings like the one it is of.

    The tests have so many degrees of freedom and these significance levels, (t,). Such a test is `chi_square_p_value`:
    chi-square where the noise is known (`log_power_variance` (n,) zero), else F, in a noise estimated anew each time.
    """
    above, level = np.array(freedom, dtype=np.float64)[:, None], np.array(significance)[:, None]
    is_known = log_power_variance <= 0
    noncentralities = np.tile(noncentrality(chi2_isf(level, above), above, LEVELS.power), (1, len(is_known)))
    if not is_known.all():
        below = np.array([2 * inverse_trigamma(float(v)) for v in log_power_variance[~is_known]])
        ratio = f_isf(level, above, below)
        noncentralities[:, ~is_known] = f_noncentrality(ratio, above, below, LEVELS.power, in_other_noise=True)
    return np.asarray(noncentralities)


def effective_number_of_tests(noise_scores: Array, rank: int) -> float:
    """Effective number of independent tests of a search over nonlinear parameters.

    `noise_scores` are largest scores of the search in draws of noise. The tail of their distribution is approximated
    by that of one chi-square (`rank` degrees of freedom) times the number of tests that their 90 % quantile implies.
    """
    high = float(np.quantile(noise_scores, 0.9))
    return max(1.0, 0.1 / max(float(chi2_sf(high, rank)), 1e-12))


def effective_number_of_frequencies(score: float, samples: int) -> float:
    """Effective number of independent tests of a search over all frequencies of a record.

    The score over frequency is a chi-square process; its supremum exceeds a high value u with the probability at one
    frequency times W sqrt(u / 2), where W = sqrt(4 pi) times the bandwidth times the std of the sampling instants
    (Davies 1987; Baluev 2008), here half the sampling rate and n steps / sqrt(12): about n / 2.
    """
    return float(max(1.0, samples / 2 * np.sqrt(np.pi / 3) * np.sqrt(max(score, 2.0) / 2)))
