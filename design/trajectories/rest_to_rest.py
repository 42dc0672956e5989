"""Trajectories at rest at both ends: a smooth ramp times a periodic series."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import comb

import numpy as np
from scipy.interpolate import BPoly

from design.trajectories.grid_bound import grid_bound
from design.trajectories.trajectory import Array, TrajectorySeries
from modeling.errors import InputError

SMOOTH_STEP = BPoly(np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])[:, None], np.array([0.0, 1.0]))
"""From 0 to 1 with no velocity, acceleration or jerk at either end: the polynomial of least degree that does it."""


@dataclass(frozen=True, kw_only=True)
class RestToRest(TrajectorySeries):
    """A posture plus a ramp times a trajectory of an inner periodic series: at rest at both ends of its period.

    The ramp rises from 0 to 1 in the first seconds and falls in the last, smooth to its third derivative, so that
    velocity, acceleration and jerk are exactly zero at both ends; between, the trajectory is the inner one. Repeated,
    it is periodic and as smooth. Coefficients: the posture of both ends (n,), then the inner ones.

    Parameters
    ----------
    inner : TrajectorySeries
        The periodic series.
    ramp : float
        Time of the rise and of the fall, s: at most half the period, which includes both.

    Raises
    ------
    InputError
        When the inner series is not periodic or the ramps do not fit into its period.

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
    joints: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", self.inner.joints)
        if not self.inner.periodic:
            what = "a periodic series was expected, and one from rest to rest came"
            raise InputError(what=what, where="RestToRest", remedy="give the series that is to be ramped")
        if not 0 < self.ramp <= self.duration / 2:
            what = f"a ramp of at most half the duration of {self.duration} s was expected, and {self.ramp} s came"
            raise InputError(what=what, where="RestToRest", remedy="give a shorter ramp or a longer period")

    def __str__(self) -> str:
        return f"from rest to rest, ramps of {self.ramp:g} s, {self.inner}"

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
        return np.asarray(np.eye(1, 1 + len(self.inner.unity))[0], dtype=float)

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
        """The posture multiplies the constant, the inner coefficients the ramped functions."""
        inner = self.inner.mixing
        mixing = np.zeros((self.joints, 1 + inner.shape[1], self.joints + inner.shape[2]))
        mixing[:, 0, : self.joints] = np.eye(self.joints)
        mixing[:, 1:, self.joints :] = inner
        return mixing

    def ramped(self, time: Array, order: int) -> Array:
        """(N,): the derivative of that order of the ramp."""
        within = np.mod(time, self.duration)
        rising = within <= self.duration / 2
        share = np.clip(np.where(rising, within, self.duration - within) / self.ramp, 0.0, 1.0)
        values = SMOOTH_STEP.derivative(order)(share) * np.where(rising, 1.0, -1.0) ** order / self.ramp**order
        return np.where((share == 1.0) & (order > 0), 0.0, values)

    def functions(self, time: Array, order: int) -> Array:
        """(N, 1 + W): one, and the ramp times the inner functions by the product rule."""
        constant = np.full((len(time), 1), float(order == 0))
        terms = [
            comb(order, i) * self.ramped(time, i)[:, None] * self.inner.functions(time, order - i)
            for i in range(order + 1)
        ]
        return np.hstack([constant, np.sum(terms, axis=0)])

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
            inner = np.abs(self.inner.enclosure(coefficients[self.joints :], high - i)).max(axis=0)
            curvature += comb(high, i) * np.multiply.outer(ramp, inner)
        return grid_bound(lambda time: self.evaluate(coefficients, time, order), curvature, self.breaks)
