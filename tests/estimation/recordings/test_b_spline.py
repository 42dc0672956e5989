"""B-splines against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline as SciPySpline

from estimation.recordings.smoothing_spline import BasisRows, BSpline, basis_matrix


def clamped(pieces: int, degree: int, rng: np.random.Generator) -> NDArray[np.float64]:
    inner = np.cumsum(rng.uniform(0.5, 1.5, pieces))
    return np.concatenate([[0.0] * (degree + 1), inner, [inner[-1]] * degree])


@pytest.mark.parametrize("degree", [1, 3, 5, 7])
def test_a_spline_and_its_slopes_are_scipys(degree: int) -> None:
    rng = np.random.default_rng(1)
    knots = clamped(30, degree, rng)
    place = np.linspace(0.0, knots[-1], 120)
    coefficients = rng.normal(size=(len(knots) - degree - 1, 3))
    found, expected = BSpline(knots, coefficients, degree), SciPySpline(knots, coefficients, degree)
    for order in range(degree):
        wanted = expected(place, order)
        np.testing.assert_allclose(found(place), wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
        found = found.derivative()


@pytest.mark.parametrize(("degree", "derivatives"), [(3, 0), (3, 3), (7, 2)])
def test_rows_serve_a_spline_and_its_derivatives(degree: int, derivatives: int) -> None:
    rng = np.random.default_rng(2)
    knots = clamped(30, degree, rng)
    place = np.linspace(0.0, knots[-1], 120)
    rows = BasisRows.of(place, knots, degree, derivatives)
    for _ in range(2):
        coefficients = rng.normal(size=(len(knots) - degree - 1, 3))
        found = rows.derivatives(BSpline(knots, coefficients, degree))
        assert len(found) == derivatives + 1
        for order, values in enumerate(found):
            wanted = SciPySpline(knots, coefficients, degree)(place, order)
            np.testing.assert_allclose(values, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


def test_basis_splines_are_scipys() -> None:
    knots = np.linspace(-3.0, 8.0, 12)
    place = np.concatenate([np.linspace(0.0, 5.0, 51), [np.nextafter(5.0, 0.0)]])
    expected = SciPySpline.design_matrix(place, knots, 3).toarray()
    np.testing.assert_allclose(basis_matrix(place, knots, 3), expected, atol=1e-15)
