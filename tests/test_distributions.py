"""Inverses against the functions that they invert."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import polygamma
from scipy.stats import ncx2

from estimation.distributions import chi2_isf, noncentrality
from estimation.interval import inverse_trigamma


@pytest.mark.parametrize("value", np.geomspace(1e-8, 1e8, 17))
def test_trigamma_of_its_inverse(value: float) -> None:
    np.testing.assert_allclose(polygamma(1, inverse_trigamma(value)), value, rtol=1e-13)


@pytest.mark.parametrize("freedom", [1, 3, 10])
@pytest.mark.parametrize("significance", [1e-2, 1e-4, 1e-8])
def test_noncentrality_gives_the_power(freedom: int, significance: float) -> None:
    limit = chi2_isf(significance, freedom)
    np.testing.assert_allclose(ncx2.sf(limit, freedom, noncentrality(limit, freedom, 0.8)), 0.8, rtol=1e-9)
