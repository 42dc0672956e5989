"""Inverses against the functions that they invert."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import polygamma
from scipy.stats import false_discovery_control, ncx2

from estimation.distributions import chi2_isf, inverse_trigamma, noncentrality
from estimation.multiplicity import false_discovery_rates


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
