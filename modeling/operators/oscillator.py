"""Oscillator: a second-order system with constant coefficients, its motion under a sampled drive found exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.operators.clock import Clock
from modeling.operators.from_rest import FromRest

Array = NDArray[np.float64]

QUICKEST = 1e-3
"""1 over a mode's natural frequency, in steps, below which it follows its drive at once as far as samples tell."""


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Of mass b'' + lag stiffness b' + stiffness b, or changes of them: symmetric (d, d) in s² and 1, lag in s."""

    mass: Array
    lag: float
    stiffness: Array


@dataclass(frozen=True, eq=False)
class Oscillator:
    """mass b'' + lag stiffness b' + stiffness b = drive, for d angles b; the stiffness is positive.

    With b = modes q, and modes' stiffness modes = 1, it parts into inertia q'' + lag q' + q = modes' drive.

    inertias  (d,), s²: 1 over the square of each mode's natural frequency (rad/s)
    modes     (d, d)
    """

    coefficients: Coefficients
    inertias: Array
    modes: Array
    clock: Clock

    @classmethod
    def of(cls, coefficients: Coefficients, clock: Clock) -> Oscillator:
        """That of those coefficients, for drives sampled by that clock."""
        from scipy.linalg import eigh

        return cls(coefficients, *eigh(coefficients.mass, coefficients.stiffness), clock)

    def response(self, drive: Array) -> Array:
        """b, b', b'' side by side, (n, 3 d), under a drive (n, d).

        Periodic: the steady state, by the lines of the spectrum up to half the sampling rate. Otherwise: from
        b(0) = drive(0) / stiffness with b'(0) = 0, for the cubic spline through the drive. Either way the equation
        holds at every sample to rounding.

        Raises InputError when it shall start from rest with a negative inertia.
        """
        own = drive @ self.modes
        return self._together(self._steady(own) if self.clock.periodic else self._from_rest.motion(own))

    def change(self, response: Array, of: Coefficients) -> Array:
        """The change of a response (n, 3 d) with a change `of` the coefficients, the drive unchanged at the samples.

        In the steady state that is a change of the drive, which has nothing else to it: 0.
        """
        if self.clock.periodic:
            return np.zeros_like(response)
        parts = np.split(response, 3, axis=1)
        q, dq, ddq = (part @ np.linalg.inv(self.modes).T for part in parts)
        drive = ddq * self.inertias + self.coefficients.lag * dq + q
        stiffer = self.modes.T @ of.stiffness @ self.modes
        heavier = self.modes.T @ of.mass @ self.modes - stiffer * self.inertias
        d_drive = -drive @ stiffer.T
        found = self._from_rest.change(drive, (q, dq, ddq), d_drive=d_drive, d_inertia=heavier, d_lag=of.lag)
        return self._together(found)

    def _together(self, parts: tuple[Array, ...]) -> Array:
        return np.concatenate([part @ self.modes.T for part in parts], axis=1)

    def _steady(self, drive: Array) -> tuple[Array, ...]:
        count = len(drive)
        omega = 2 * np.pi * np.fft.rfftfreq(count, self._step)[:, None]
        first, second = 1j * omega, -(omega**2)
        if count % 2 == 0:
            first[-1] = 0.0  # The sine of half the sampling rate is zero at every sample.
        lines = np.fft.rfft(drive, axis=0) / (1 + self.coefficients.lag * first + self.inertias * second)
        return tuple(np.fft.irfft(lines * factor, n=count, axis=0) for factor in (1.0, first, second))

    @property
    def _step(self) -> float:
        return 1.0 if self.clock.dt is None else self.clock.dt

    @cached_property
    def _from_rest(self) -> FromRest:
        shortest = (QUICKEST * self._step) ** 2
        if np.any(self.inertias < -shortest):
            raise InputError(
                what="the tool's inertia is not positive, and on a spring it would run away",
                where="tip_flexibility",
                remedy="fit it with --physical, or record a motion that repeats",
            )
        return FromRest(np.maximum(self.inertias, shortest), self.coefficients.lag, self._step)
