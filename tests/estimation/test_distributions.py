"""Inverses against the functions that they invert."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import polygamma
from scipy.stats import binom, f, false_discovery_control, ncf, ncx2

from estimation.multiplicity import (
    binomial_sf,
    chi2_isf,
    f_isf,
    f_noncentrality,
    false_discovery_rates,
    inverse_trigamma,
    noncentrality,
)


@pytest.mark.parametrize("value", np.geomspace(1e-8, 1e8, 17))
def test_trigamma_of_its_inverse(value: float) -> None:
    np.testing.assert_allclose(polygamma(1, inverse_trigamma(value)), value, rtol=1e-13)


@pytest.mark.parametrize("freedom", [1, 3, 10])
@pytest.mark.parametrize("significance", [1e-2, 1e-4, 1e-8])
def test_noncentrality_gives_the_power(freedom: int, significance: float) -> None:
    limit = chi2_isf(significance, freedom)
    np.testing.assert_allclose(ncx2.sf(limit, freedom, noncentrality(limit, freedom, 0.8)), 0.8, rtol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_false_discovery_rates_are_scipys(seed: int) -> None:
    random = np.random.default_rng(seed)
    p_values = random.uniform(size=random.integers(1, 40)) ** 3
    p_values[: len(p_values) // 3] = p_values[-1]  # equal ones
    np.testing.assert_allclose(false_discovery_rates(p_values), false_discovery_control(p_values), rtol=1e-14)


@pytest.mark.parametrize("above", [1, 3, 24])
@pytest.mark.parametrize("below", [3.0, 10.0, 1e3])
def test_noncentrality_of_f_gives_the_power(above: int, below: float) -> None:
    """Against SciPy's noncentral F; within the error of the cube-root approximation, 1 % of power."""
    limit = f_isf(0.01, above, below)
    np.testing.assert_allclose(limit, f.isf(0.01, above, below), rtol=1e-9)
    needed = f_noncentrality(np.array([[limit]]), np.array([[above]]), np.array([below]), 0.8)[0]
    np.testing.assert_allclose(ncf.sf(limit, above, below, needed), 0.8, atol=0.015)


@pytest.mark.parametrize("below", [10.0, 80.0])
def test_noncentrality_stated_in_other_noise_gives_the_power(below: float) -> None:
    """Against draws; their std is 0.1 % of power, the approximation's error 1 %."""
    rng, draws, limit = np.random.default_rng(0), 100_000, f_isf(4e-4, 1, below)
    needed = f_noncentrality(np.array([[limit]]), np.array([[1]]), np.array([below]), 0.8, in_other_noise=True)[0]
    stated, tested = rng.chisquare(below, (2, draws)) / below
    above = (rng.standard_normal(draws) + np.sqrt(needed * stated)) ** 2 > limit * tested
    np.testing.assert_allclose(above.mean(), 0.8, atol=0.015)


def test_tails_of_f_are_exact() -> None:
    np.testing.assert_allclose(f.sf(f_isf(1e-14, 3, 7.0), 3, 7.0), 1e-14, rtol=1e-9)


@pytest.mark.parametrize(("count", "total", "probability"), [(0, 5, 0.1), (3, 40, 0.02), (40, 40, 0.9)])
def test_binomial_tail(count: int, total: int, probability: float) -> None:
    np.testing.assert_allclose(binomial_sf(count, total, probability), binom.sf(count - 1, total, probability))
