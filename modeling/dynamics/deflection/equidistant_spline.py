"""Cubic spline through equidistant values: SciPy's `CubicSpline`, whose import takes a sixth of a `diagnose`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def interpolated(values: Array, factor: int, count: int) -> Array:
    """The spline through values (d, n), n >= 4, at `count` places 1 / `factor` intervals apart, from the first on."""
    slopes = SplineSlopes.of(values.shape[1]).of_values(values)
    places = np.arange(count) / factor
    before = np.minimum(places.astype(int), values.shape[1] - 2)
    part, rise = places - before, np.diff(values)[:, before]
    start, end = slopes[:, before], slopes[:, before + 1]
    quadratic = 3 * rise - 2 * start - end
    return np.asarray(values[:, before] + part * (start + part * (quadratic + part * (start + end - 2 * rise))))


@dataclass(frozen=True, eq=False)
class SplineSlopes:
    """Slopes of the cubic spline through n equidistant values, by factorisation of its tridiagonal system.

    s_{i-1} + 4 s_i + s_{i+1} = 3 (y_{i+1} - y_{i-1}) inside; not-a-knot conditions at the ends, s_0 + 2 s_1 =
    (5 (y_1 - y_0) + y_2 - y_1) / 2 and its mirror image (de Boor, A Practical Guide to Splines, 1978, IV): SciPy's
    `CubicSpline` with stored factors. Eliminating s_0 and s_{n-1} makes the system symmetric: 2 s_1 + s_2 is the second
    right-hand side minus the first.

    factors  diagonal and subdiagonal of the Cholesky factors for the inner n - 2 slopes
    """

    factors: tuple[Array, Array]

    @classmethod
    def of(cls, count: int) -> SplineSlopes:
        """For n >= 4 values; cached."""
        return _factored(count)

    def of_values(self, y: Array) -> Array:
        """Slopes (d, n) per step, of values (d, n)."""
        from scipy.linalg.lapack import dpttrs

        first = (5 * (y[:, 1] - y[:, 0]) + y[:, 2] - y[:, 1]) / 2
        last = (5 * (y[:, -1] - y[:, -2]) + y[:, -2] - y[:, -3]) / 2
        right = 3 * (y[:, 2:] - y[:, :-2])
        right[:, 0] -= first
        right[:, -1] -= last
        found = np.empty_like(y)
        found[:, 1:-1] = dpttrs(*self.factors, right.T, overwrite_b=True)[0].T
        found[:, 0], found[:, -1] = first - 2 * found[:, 1], last - 2 * found[:, -2]
        return found


@lru_cache(maxsize=8)
def _factored(count: int) -> SplineSlopes:
    from scipy.linalg.lapack import dpttrf

    middle = np.full(count - 2, 4.0)
    middle[[0, -1]] = 2.0
    return SplineSlopes(dpttrf(middle, np.ones(count - 3))[:2])
