"""Exact response of a linear second-order system with constant coefficients to a sampled input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from modeling.dynamics.deflection.transient_equations import TransientEquations
from modeling.dynamics.deflection.transient_response import TransientResponse
from modeling.dynamics.time_base import TimeBase
from modeling.errors import InputError

Array = NDArray[np.float64]

SHORTEST_TIME_CONSTANT = 1e-3
"""Lower bound of 1 / (natural frequency) of a mode, in sampling intervals; faster modes are quasi-static."""


@dataclass(frozen=True, eq=False)
class OscillatorCoefficients:
    """mass b'' + lag stiffness b' + stiffness b, or changes of it: symmetric (d, d) in s² and 1, lag in s."""

    mass: Array
    lag: float
    stiffness: Array


@dataclass(frozen=True, eq=False)
class Oscillator:
    """mass b'' + lag stiffness b' + stiffness b = input, for d angles b; the stiffness is positive definite.

    With b = modes q, and modes' stiffness modes = 1, it decouples into inertia q'' + lag q' + q = modes' input.

    inertias  (d,), s²: 1 / natural frequency (rad/s) squared of each mode
    modes     (d, d)
    """

    coefficients: OscillatorCoefficients
    inertias: Array
    modes: Array
    clock: TimeBase

    @classmethod
    def of(cls, coefficients: OscillatorCoefficients, clock: TimeBase) -> Oscillator:
        """The oscillator of those coefficients, for inputs on that time base."""
        from scipy.linalg import eigh

        return cls(coefficients, *eigh(coefficients.mass, coefficients.stiffness), clock)

    def response(self, drive: Array) -> Array:
        """b, b', b'' stacked, (3 d, n), for an input (d, n).

        Periodic: the steady state, by discrete Fourier transform. Otherwise: from b(0) = input(0) / stiffness with
        b'(0) = 0, for the cubic spline through the input. In both cases the equation holds at every sample to rounding.

        Raises InputError for a transient response with negative inertia.
        """
        modal = self.modes.T @ drive
        return self._modal_to_angles(
            self._steady_state(modal) if self.clock.periodic else self._transient.motion(modal)
        )

    def transient_inputs(self, by_response: Array, rights: Array) -> Array:
        """Inputs (k, d, n) whose transient response solves by_response (n, d, 3 d) response = right, for (k, d, n).

        By one banded factorisation, to rounding. Raises LinAlgError where there is none.
        """
        by_modes = [part @ self.modes for part in np.split(by_response, 3, axis=2)]
        modal = TransientEquations.of(self._transient, *by_modes)
        return np.asarray(np.linalg.solve(self.modes.T, modal.inputs(rights)))

    def drive(self, response: Array) -> Array:
        """The input (d, n) that has the response (3 d, n)."""
        mass, lag, stiffness = self.coefficients.mass, self.coefficients.lag, self.coefficients.stiffness
        return np.asarray(np.hstack([stiffness, lag * stiffness, mass]) @ response)

    def change(self, response: Array, of: OscillatorCoefficients) -> Array:
        """The change of a response (3 d, n) with a change `of` the coefficients, the input unchanged at the samples.

        0 in the steady state, where a change of coefficients is equivalent to a change of the input.
        """
        if self.clock.periodic:
            return np.zeros_like(response)
        motion = np.asarray(np.linalg.inv(self.modes) @ np.stack(np.split(response, 3)), dtype=np.float64)
        q, dq, ddq = motion
        drive = ddq * self.inertias[:, None] + self.coefficients.lag * dq + q
        stiffer = self.modes.T @ of.stiffness @ self.modes
        heavier = self.modes.T @ of.mass @ self.modes - stiffer * self.inertias
        return self._modal_to_angles(
            self._transient.change(drive, motion, d_drive=-stiffer @ drive, d_inertia=heavier, d_lag=of.lag)
        )

    def _modal_to_angles(self, motion: Array) -> Array:
        """Motion of the angles (3 d, n) from that of the modes (3, d, n)."""
        return np.asarray(self.modes @ motion).reshape(-1, motion.shape[2])

    def _steady_state(self, drive: Array) -> Array:
        lines = fft.rfft(drive) * self._gains(drive.shape[1])
        return np.asarray(fft.irfft(lines, n=drive.shape[1]))

    def _gains(self, count: int) -> NDArray[np.complex128]:
        """Frequency responses from modal input to q, q' and q'', (3, d, lines), for a record of n samples."""
        if count not in self._gains_by_count:
            omega = 2 * np.pi * np.fft.rfftfreq(count, self._step)
            first, second = 1j * omega, -(omega**2)
            if count % 2 == 0:
                first[-1] = 0.0  # The sine at the Nyquist frequency is zero at every sample.
            response = 1 / (1 + self.coefficients.lag * first + self.inertias[:, None] * second)
            self._gains_by_count[count] = np.stack([response, response * first, response * second])
        return self._gains_by_count[count]

    @cached_property
    def _gains_by_count(self) -> dict[int, NDArray[np.complex128]]:
        return {}

    @property
    def _step(self) -> float:
        return 1.0 if self.clock.dt is None else self.clock.dt

    @cached_property
    def _transient(self) -> TransientResponse:
        shortest = (SHORTEST_TIME_CONSTANT * self._step) ** 2
        if np.any(self.inertias < -shortest):
            raise InputError(
                what="the tool's inertia is not positive: the deflection is unstable",
                where="tip_flexibility",
                remedy="fit it with --physical, or record a periodic motion",
            )
        return TransientResponse(np.maximum(self.inertias, shortest), self.coefficients.lag, self._step)
