"""Periodic B-spline trajectories on uniform knots."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import comb

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray
from scipy.interpolate import BPoly, BSpline

from design.trajectories.trajectory import Array, TrajectorySeries, grid_bound, require_positive_duration
from modeling.errors import InputError

SMOOTH_STEP = BPoly(np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])[:, None], np.array([0.0, 1.0]))
"""From 0 to 1 with no velocity, acceleration or jerk at either end: the polynomial of least degree that does it."""


@dataclass(frozen=True, kw_only=True)
class RestToRest(TrajectorySeries):
    """A posture plus a ramp times a trajectory of an inner periodic series: at rest at both ends of its period.

    The ramp rises from 0 to 1 in the first seconds and falls in the last, smooth to its third derivative, so that
    velocity, acceleration and jerk are exactly zero at both ends; between, the trajectory is the inner one. Repeated,
    it is periodic and as smooth. Coefficients: the posture of both ends (n,), then the inner ones. Where the posture is
    stated a design does not choose it; to another one at the end it moves all the while, as smoothly: by a multiple
    (n,) of its own, after the posture.

    Parameters
    ----------
    inner : TrajectorySeries
        The periodic series.
    ramp : float
        Time of the rise and of the fall, s: at most half the period, which includes both.
    start : tuple of float, optional
        The posture at both ends (n,), or at the first; by default chosen.
    end : tuple of float, optional
        That at the end; by default the start.

    Raises
    ------
    InputError
        When the inner series is not periodic, the ramps do not fit into its period, or a posture is of other joints.

    Examples
    --------
    >>> import truewrench as tw
    >>> inner = tw.FreeSeries(joints=3, harmonics=(1, 2), period=5.0)
    >>> series = tw.RestToRest(inner=inner, ramp=0.5)
    >>> series.size - inner.size
    3
    """

    inner: TrajectorySeries
    ramp: float
    start: tuple[float, ...] | None = None
    end: tuple[float, ...] | None = None
    joints: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", self.inner.joints)
        if not self.inner.periodic:
            what = "a periodic series was expected, and one from rest to rest came"
            raise InputError(what=what, where="RestToRest", remedy="give the series that is to be ramped")
        if not 0 < self.ramp <= self.duration / 2:
            what = f"a ramp of at most half the duration of {self.duration} s was expected, and {self.ramp} s came"
            raise InputError(what=what, where="RestToRest", remedy="give a shorter ramp or a longer period")
        if any(pose is not None and len(pose) != self.joints for pose in (self.start, self.end)):
            what = f"postures of {self.joints} joints were expected of start and end"
            raise InputError(what=what, where="RestToRest", remedy="give a coordinate for each joint")
        if self.end is not None and self.start is None:
            raise InputError(what="an end was given without a start", where="RestToRest", remedy="give both")

    def __str__(self) -> str:
        return f"from rest to rest, ramps of {self.ramp:g} s, {self.inner}"

    @property
    def travel(self) -> Array | None:
        """(n,): from the start to the end; None where it ends where it starts."""
        if self.start is None or self.end is None or self.end == self.start:
            return None
        return np.subtract(self.end, self.start)

    @property
    def _ends(self) -> int:
        """Coefficients before the inner ones."""
        return self.joints * (1 if self.travel is None else 2)

    @property
    def adjustable(self) -> NDArray[np.bool_]:
        """All but a stated posture, and the way from it to another."""
        return np.arange(self.size) >= (0 if self.start is None else self._ends)

    def rest(self, posture: npt.ArrayLike) -> Array:
        """The static posture, or the stated one, with the way from it to the end."""
        if self.start is None:
            return super().rest(posture)
        ends = [*self.start, *([] if self.travel is None else self.travel)]
        return np.array([*ends, *np.zeros(self.size - len(ends))])

    @property
    def duration(self) -> float:
        """The period of the inner series, ramps included, s."""
        return self.inner.duration

    @property
    def periodic(self) -> bool:
        """False: it ends at rest."""
        return False

    @property
    def unity(self) -> Array:
        """The first function is one."""
        return np.asarray(np.eye(1, self.mixing.shape[1])[0], dtype=float)

    @property
    def smoothness(self) -> float:
        """The inner one's; the ramp's fourth derivative has steps."""
        return min(self.inner.smoothness, 4)

    @property
    def breaks(self) -> Array:
        """The inner ones and the ends of the ramps, s."""
        return np.unique([*self.inner.breaks, self.ramp, self.duration - self.ramp])

    @cached_property
    def mixing(self) -> Array:
        """The posture multiplies the constant, the way to the end the step, inner coefficients ramped functions."""
        inner, ends = self.inner.mixing, self._ends // self.joints
        mixing = np.zeros((self.joints, ends + inner.shape[1], self._ends + inner.shape[2]))
        for function in range(ends):
            mixing[:, function, function * self.joints : (function + 1) * self.joints] = np.eye(self.joints)
        mixing[:, ends:, self._ends :] = inner
        return mixing

    def ramped(self, time: Array, order: int) -> Array:
        """(N,): the derivative of that order of the ramp."""
        within = np.mod(time, self.duration)
        rising = within <= self.duration / 2
        share = np.clip(np.where(rising, within, self.duration - within) / self.ramp, 0.0, 1.0)
        values = SMOOTH_STEP.derivative(order)(share) * np.where(rising, 1.0, -1.0) ** order / self.ramp**order
        return np.where((share == 1.0) & (order > 0), 0.0, values)

    def functions(self, time: Array, order: int) -> Array:
        """(N, 1 + W): one, and the ramp times the inner functions by the product rule; after one the step, if any."""
        ends = [np.full((len(time), 1), float(order == 0))]
        if self.travel is not None:
            share = np.clip(time / self.duration, 0.0, 1.0)
            ends.append(SMOOTH_STEP.derivative(order)(share)[:, None] / self.duration**order)
        terms = [
            comb(order, i) * self.ramped(time, i)[:, None] * self.inner.functions(time, order - i)
            for i in range(order + 1)
        ]
        return np.hstack([*ends, np.sum(terms, axis=0)])

    def enclosure(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """Bounds from a grid with the breaks in it; the product rule bounds the derivative two orders higher.

        |(r p)_o| <= sum_i C(o, i) |r_i| |p_o-i| for the derivatives of order o: the ramp's stay between their Bernstein
        coefficients where it rises or falls and are zero between, the inner trajectory's within its own enclosures.
        """
        high, middle = order + 2, (self.breaks[:-1] + self.breaks[1:]) / 2
        ramping = (middle < self.ramp) | (middle > self.duration - self.ramp)
        curvature = np.zeros((len(middle), self.joints))
        for i in range(high + 1):
            ramp = np.where(ramping | (i == 0), np.abs(SMOOTH_STEP.derivative(i).c).max() / self.ramp**i, 0.0)
            inner = np.abs(self.inner.enclosure(coefficients[self._ends :], high - i)).max(axis=0)
            curvature += comb(high, i) * np.multiply.outer(ramp, inner)
        if self.travel is not None:
            step = np.abs(SMOOTH_STEP.derivative(high).c).max() / self.duration**high
            curvature += step * np.abs(coefficients[self.joints : self._ends])
        return grid_bound(lambda time: self.evaluate(coefficients, time, order), curvature, self.breaks)


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
