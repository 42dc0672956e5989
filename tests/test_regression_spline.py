"""Regression splines against SciPy's, and where they are exact."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline

from estimation.recordings.regression_spline import RegressionSpline, basis_matrix


def clamped(pieces: int, degree: int, rng: np.random.Generator) -> NDArray[np.float64]:
    inner = np.cumsum(rng.uniform(0.5, 1.5, pieces))
    return np.concatenate([[0.0] * (degree + 1), inner, [inner[-1]] * degree])


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_the_nearest_spline_and_its_slopes_are_scipys(degree: int) -> None:
    rng = np.random.default_rng(1)
    knots = clamped(30, degree, rng)
    place = np.linspace(0.0, knots[-1], 120)
    values = rng.normal(size=(120, 3))
    found, fitted = RegressionSpline.nearest(place, values, knots, degree)
    expected = make_lsq_spline(place, values, knots, degree)
    np.testing.assert_array_equal(fitted, found(place))
    for order in range(degree):
        wanted = expected(place, order)
        # Rounding, times what four samples a piece leave of the equations' condition.
        np.testing.assert_allclose(found(place), wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())
        found = found.derivative()


def test_a_polynomial_is_its_own_nearest_spline() -> None:
    place = np.linspace(0.0, 40.0, 90)  # hardly more than two samples a piece
    knots = np.concatenate([[0.0] * 6, np.arange(1.0, 40.0), [40.0] * 6])
    x = place[:, None] / 40
    spline, fitted = RegressionSpline.nearest(place, x**5 - x**2, knots, 5)
    # Rounding; a derivative of the coefficients costs a digit.
    np.testing.assert_allclose(fitted, x**5 - x**2, atol=1e-13)
    second = spline.derivative().derivative()(place) * 40**2
    np.testing.assert_allclose(second, 20 * x**3 - 2, atol=1e-9)


def test_basis_splines_are_scipys() -> None:
    knots = np.linspace(-3.0, 8.0, 12)
    place = np.concatenate([np.linspace(0.0, 5.0, 51), [np.nextafter(5.0, 0.0)]])
    expected = BSpline.design_matrix(place, knots, 3).toarray()
    np.testing.assert_allclose(basis_matrix(place, knots, 3), expected, atol=1e-15)
