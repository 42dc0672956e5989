"""Sum of B-splines on given knots, and its derivatives.

`scipy.interpolate` has it too, but its import takes a sixth of a `diagnose` in the plane (28 November 2026).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BSpline:
    """sum_j c_j B_j(x) with B-splines of one degree.

    knots         (m + degree + 1,), ascending; the spline reaches from the first to the last, which may repeat
    coefficients  (m, k), of k series
    """

    knots: Array
    coefficients: Array
    degree: int

    def derivative(self) -> BSpline:
        """The spline of one degree less that is its slope: c'_j = d (c_j+1 - c_j) / (t_j+d+1 - t_j+1)."""
        widths = self.knots[self.degree + 1 : -1] - self.knots[1 : -self.degree - 1]
        slopes = self.degree * np.diff(self.coefficients, axis=0) / widths[:, None]
        return BSpline(self.knots[1:-1], slopes, self.degree - 1)

    def __call__(self, place: Array) -> Array:
        """Values (n, k) at places (n,)."""
        return weighted_sum(*basis_values(place, self.knots, self.degree), self.coefficients)


@dataclass(frozen=True, eq=False)
class BasisRows:
    """B-splines at some places, for a spline on their knots and its derivatives.

    first   (n,) index of the first nonzero one
    values  (degree + 1 - d, n) each, of the d-th derivative's degree, d = 0, 1, ..
    """

    first: NDArray[np.intp]
    values: tuple[Array, ...]

    @classmethod
    def of(cls, place: Array, knots: Array, degree: int, derivatives: int) -> BasisRows:
        """At places (n,), for so many derivatives."""
        first, values = _basis_of_degrees(place, knots, degree, degree - derivatives)
        return cls(first, tuple(values[::-1]))

    def derivatives(self, spline: BSpline) -> list[Array]:
        """Values (n, k) of a spline and of its derivatives."""
        found = [weighted_sum(self.first, self.values[0], spline.coefficients)]
        for basis in self.values[1:]:
            spline = spline.derivative()
            found.append(weighted_sum(self.first, basis, spline.coefficients))
        return found


def basis_matrix(place: Array, knots: Array, degree: int) -> Array:
    """Values (n, m) of the m B-splines on these knots at places (n,)."""
    first, basis = basis_values(place, knots, degree)
    matrix = np.zeros((len(place), len(knots) - degree - 1))
    matrix[np.arange(len(place))[:, None], first[:, None] + np.arange(degree + 1)] = basis.T
    return matrix


def basis_values(place: Array, knots: Array, degree: int) -> tuple[NDArray[np.intp], Array]:
    """The nonzero B-splines at each place: the first one's index (n,), and their values (degree + 1, n)."""
    first, values = _basis_of_degrees(place, knots, degree, degree)
    return first, values[0]


def _basis_of_degrees(place: Array, knots: Array, degree: int, lowest: int) -> tuple[NDArray[np.intp], list[Array]]:
    """Index (n,) of the first nonzero B-spline, and values (d + 1, n) of the nonzero ones of degrees d from `lowest`.

    By the recurrence of Cox and de Boor from degree to degree (Piegl and Tiller, The NURBS Book, A2.2). The index is
    that of a lower degree too, on knots less one at each end for each degree, which are those of the derivatives.
    """
    piece = np.clip(np.searchsorted(knots, place, side="right") - 1, degree, len(knots) - degree - 2)
    steps = np.arange(degree)[:, None]
    after, before = knots[piece + 1 + steps] - place, place - knots[piece - steps]
    found = [np.ones((1, len(place)))]
    for order in range(degree):
        left, right = after[: order + 1], before[order::-1]
        share = found[-1] / (left + right)
        basis = np.zeros((order + 2, len(place)))
        basis[:-1] = left * share
        basis[1:] += right * share
        found.append(basis)
    return piece - degree, found[lowest:]


def weighted_sum(first: NDArray[np.intp], basis: Array, coefficients: Array) -> Array:
    """B c (n, k) of coefficients (m, k), B as `basis_values` gives it."""
    total, part = np.zeros((2, len(first), coefficients.shape[1]))
    for j, values in enumerate(basis):
        np.take(coefficients, first + j, axis=0, out=part, mode="clip")  # with another mode NumPy copies
        part *= values[:, None]
        total += part
    return total


def transposed_sum(first: NDArray[np.intp], basis: Array, values: Array, count: int) -> Array:
    """B' v (count, k)."""
    products = np.zeros((count, values.shape[1]))
    for j, weights in enumerate(basis):
        for column, series in enumerate(values.T):
            products[:, column] += np.bincount(first + j, weights * series, minlength=count)
    return products
