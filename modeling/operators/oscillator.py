"""Oscillator: a second-order system with constant coefficients, its motion under a sampled drive found exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

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
        """b, b', b'' one below the other, (3 d, n), under a drive (d, n).

        Periodic: the steady state, by the lines of the spectrum up to half the sampling rate. Otherwise: from
        b(0) = drive(0) / stiffness with b'(0) = 0, for the cubic spline through the drive. Either way the equation
        holds at every sample to rounding.

        Raises InputError when it shall start from rest with a negative inertia.
        """
        own = self.modes.T @ drive
        return self._together(self._steady(own) if self.clock.periodic else self._from_rest.motion(own))

    def drive(self, response: Array) -> Array:
        """The drive (d, n) that a response (3 d, n) is to."""
        mass, lag, stiffness = self.coefficients.mass, self.coefficients.lag, self.coefficients.stiffness
        return np.asarray(np.hstack([stiffness, lag * stiffness, mass]) @ response)

    def change(self, response: Array, of: Coefficients) -> Array:
        """The change of a response (3 d, n) with a change `of` the coefficients, the drive unchanged at the samples.

        In the steady state that is a change of the drive, which has nothing else to it: 0.
        """
        if self.clock.periodic:
            return np.zeros_like(response)
        motion = np.asarray(np.linalg.inv(self.modes) @ np.stack(np.split(response, 3)), dtype=np.float64)
        q, dq, ddq = motion
        drive = ddq * self.inertias[:, None] + self.coefficients.lag * dq + q
        stiffer = self.modes.T @ of.stiffness @ self.modes
        heavier = self.modes.T @ of.mass @ self.modes - stiffer * self.inertias
        return self._together(
            self._from_rest.change(drive, motion, d_drive=-stiffer @ drive, d_inertia=heavier, d_lag=of.lag)
        )

    def _together(self, parts: Array) -> Array:
        """Modes' motion (3, d, n) as that of the angles (3 d, n)."""
        return np.asarray(self.modes @ parts).reshape(-1, parts.shape[2])

    def _steady(self, drive: Array) -> Array:
        lines = fft.rfft(drive) * self._gains(drive.shape[1])
        return np.asarray(fft.irfft(lines, n=drive.shape[1]))

    def _gains(self, count: int) -> NDArray[np.complex128]:
        """What lines of q, q' and q'' have of those of the modes' drive, (3, d, lines), in a series of n samples."""
        if count not in self._known:
            omega = 2 * np.pi * np.fft.rfftfreq(count, self._step)
            first, second = 1j * omega, -(omega**2)
            if count % 2 == 0:
                first[-1] = 0.0  # The sine of half the sampling rate is zero at every sample.
            follows = 1 / (1 + self.coefficients.lag * first + self.inertias[:, None] * second)
            self._known[count] = np.stack([follows, follows * first, follows * second])
        return self._known[count]

    @cached_property
    def _known(self) -> dict[int, NDArray[np.complex128]]:
        return {}

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
