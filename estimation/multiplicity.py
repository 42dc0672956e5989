"""Corrections for multiple tests (Bonferroni, Holm, false discovery rate), thresholds and effective number of tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_isf, chi2_sf, f_isf, f_noncentrality, inverse_trigamma, noncentrality
from modeling.chain.model import WrenchModel
from modeling.significance import LEVELS

Array = NDArray[np.float64]


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
    """Noncentrality (t, n) that each of t score tests detects with 80 % power.

    The tests have so many degrees of freedom and these significance levels, (t,). Such a test is `chi_square_p_value`:
    chi-square where the noise is known (`log_power_variance` (n,) zero), else F.
    """
    above, level = np.array(freedom, dtype=np.float64)[:, None], np.array(significance)[:, None]
    known = log_power_variance <= 0
    found = np.tile(noncentrality(chi2_isf(level, above), above, LEVELS.power), (1, len(known)))
    if not known.all():
        below = np.array([2 * inverse_trigamma(float(v)) for v in log_power_variance[~known]])
        found[:, ~known] = f_noncentrality(f_isf(level, above, below), above, below, LEVELS.power)
    return np.asarray(found)


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
