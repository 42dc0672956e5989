"""Periodic B-spline trajectories on uniform knots."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from design.trajectories.grid_bound import grid_bound
from design.trajectories.trajectory import Array, TrajectorySeries, require_positive_duration
from modeling.errors import InputError

LOWEST_DEGREE = 2
"""Least degree: the acceleration is then constant between knots, as of a bang-bang trajectory. From degree 3 on it is
continuous, from 4 on the jerk too."""
HIGHEST_DEGREE = 9
"""Highest degree: beyond, a spline is as good as a Fourier series, and its coefficients are nearly collinear."""


@dataclass(frozen=True, kw_only=True)
class SplineSeries(TrajectorySeries):
    """Joints that each follow a periodic spline, by its values of uniform B-splines.

    Coefficients joint by joint, in the coordinate's unit; the functions are nonnegative and add up to one, so that a
    spline stays between its coefficients.

    Parameters
    ----------
    joints : int
        Number n of joints.
    knots : int
        Number of B-splines of each joint, more than the degree.
    degree : int, optional
        Of the polynomials, 2 to 9, by default 5.
    period : float
        In s.

    Raises
    ------
    InputError
        For a period that is not positive, a degree below 2 or above 9, or no more knots than the degree.

    Examples
    --------
    >>> import truewrench as tw
    >>> tw.SplineSeries(joints=3, knots=12, period=5.0).size
    36
    """

    joints: int
    knots: int
    degree: int = 5
    period: float

    def __post_init__(self) -> None:
        require_positive_duration(self.period, name="period", where="SplineSeries")
        if not LOWEST_DEGREE <= self.degree <= min(HIGHEST_DEGREE, self.knots - 1):
            expected = f"a degree of {LOWEST_DEGREE} to {HIGHEST_DEGREE} and more knots expected"
            what = f"{expected}, and {self.degree} and {self.knots} came"
            raise InputError(what=what, where="SplineSeries", remedy="give for instance degree 5 and 20 knots")

    def __str__(self) -> str:
        return f"each joint with a periodic spline of degree {self.degree} on {self.knots} knots"

    @property
    def duration(self) -> float:
        """The period, s."""
        return self.period

    @property
    def unity(self) -> Array:
        """All functions add up to one."""
        return np.ones(self.knots)

    @property
    def smoothness(self) -> float:
        """The degree: the derivative of that order has steps, the next one impulses."""
        return self.degree

    @property
    def breaks(self) -> Array:
        """The knots, s."""
        return np.linspace(0.0, self.period, self.knots + 1)

    @cached_property
    def mixing(self) -> Array:
        """Every joint has its own coefficient of every basis function."""
        each = np.multiply.outer(np.eye(self.joints), np.eye(self.knots))
        return each.transpose(0, 2, 1, 3).reshape(self.joints, self.knots, -1)

    @cached_property
    def _splines(self) -> BSpline:
        """The functions over one period: B-splines that pass its end continue at its start."""
        extended = np.arange(-self.degree, self.knots + self.degree + 1) * (self.period / self.knots)
        return BSpline(extended, np.eye(self.knots)[np.arange(self.knots + self.degree) % self.knots], self.degree)

    def functions(self, time: Array, order: int) -> Array:
        """(N, knots): the B-splines."""
        return np.asarray(self._splines(np.mod(time, self.period), nu=order), dtype=float)

    def slopes(self, coefficients: Array, order: int) -> Array:
        """(knots, n): bounds on the absolute value of the derivative of that order from each knot to the next.

        It is a spline of the degree less the order, whose B-spline coefficients are the differences c_i - c_i-1 of
        those before over the knots' distance (C. de Boor, A Practical Guide to Splines, 1978, chapter X); between two
        knots it stays between the coefficients of the B-splines that are not zero there. Zero above the degree.
        """
        values = np.asarray(coefficients, dtype=float).reshape(self.joints, self.knots).T
        if order > self.degree:
            return np.zeros_like(values)
        for _ in range(order):
            values = (values - np.roll(values, 1, axis=0)) * (self.knots / self.period)
        present = [np.roll(values, -i, axis=0) for i in range(order, self.degree + 1)]
        return np.asarray(np.abs(present).max(axis=0), dtype=float)

    def enclosure(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """Bounds from a grid with the knots in it, and from `slopes` two orders higher."""
        curvature = self.slopes(coefficients, order + 2)
        return grid_bound(lambda time: self.evaluate(coefficients, time, order), curvature, self.breaks)
