"""Exact response of second-order modes to a cubic-spline input, from static equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modeling.dynamics.deflection.equidistant_spline import SplineSlopes

Array = NDArray[np.float64]

HERMITE_COEFFICIENTS = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-6.0, 6.0, -4.0, -2.0], [12.0, -12.0, 6.0, 6.0]]
)
"""Value and derivatives of a cubic at the start of a step, from its values and slopes at both ends (Hermite)."""


@dataclass(frozen=True, eq=False)
class TransientResponse:
    """inertia_i q_i'' + lag q_i' + q_i = input_i for d modes; q(0) = input(0), q'(0) = 0. Series (d, n), step dt (s).

    inertias (d,) in s², positive; lag in s.
    """

    inertias: Array
    lag: float
    dt: float

    def motion(self, drive: Array) -> Array:
        """q, q' and q'' at the samples, (3, d, n).

        The state x = (q, q') obeys x_next = step x + gains e, with e the spline's values and slopes at both ends: a
        cubic is the output of a chain of integrators, and the matrix exponential of the modes augmented by that chain
        (Van Loan, IEEE Trans. Automatic Control 23, 1978) gives both, without cancellation. The recursion loses
        precision, about eps / (omega dt)², for slow modes sampled fast.
        """
        found = np.empty((3, *drive.shape))
        self._recurrence(drive[:, 0], self._gains_of_modes @ _ends(drive), found[:2])
        return self._accelerated(found, drive)

    def change(self, drive: Array, motion: Array, *, d_drive: Array, d_inertia: Array, d_lag: float) -> Array:
        """Directional derivative of that motion for changes of the input (d, n), the inertia (d, d) and the lag.

        Exact, with the Fréchet derivative of the matrix exponential (Al-Mohy and Higham 2009): for a mode faster than
        the sampling rate, the phase error is immediate otherwise.
        """
        d = len(drive)
        step, gains = self._flow_change(d_inertia, d_lag)
        states = motion[:2, :, :-1].reshape(2 * d, -1)
        forcing = (step @ states + gains @ _stacked(_ends(drive)) + self.gains @ _stacked(_ends(d_drive))).reshape(
            2, d, -1
        )
        found = np.empty(motion.shape)
        self._recurrence(d_drive[:, 0], forcing.swapaxes(0, 1), found[:2])
        return self._accelerated(found, d_drive - d_lag * motion[1] - d_inertia @ motion[2])

    def _accelerated(self, motion: Array, drive: Array) -> Array:
        """The motion (3, d, n) with the accelerations of the equation of motion, in place."""
        np.multiply(motion[1], -self.lag, out=motion[2])
        motion[2] -= motion[0]
        motion[2] += drive
        motion[2] /= self.inertias[:, None]
        return motion

    @cached_property
    def _generator(self) -> Array:
        """System matrix (6 d, 6 d) of (q, q', input and its three derivatives per step), times the step.

        Rates are scaled by the natural frequencies, against rounding errors.
        """
        d = len(self.inertias)
        frequency = np.diag(1 / np.sqrt(self.inertias)) * self.dt
        found = np.zeros((6 * d, 6 * d))
        found[:d, d : 2 * d] = found[d : 2 * d, 2 * d : 3 * d] = frequency
        found[d : 2 * d, :d] = -frequency
        found[d : 2 * d, d : 2 * d] = -self.lag * frequency**2 / self.dt
        found[2 * d : 5 * d, 3 * d :] = np.eye(3 * d)
        return found

    @cached_property
    def _scale(self) -> Array:
        d = len(self.inertias)
        ones = np.ones(6 * d)
        ones[d : 2 * d] /= np.sqrt(self.inertias)
        return ones

    def _step_and_gains(self, exponential: Array) -> tuple[Array, Array]:
        """Step (2 d, 2 d) and gains (2 d, 4 d), for y0, y1, s0, s1 of all modes, from an exponential (6 d, 6 d)."""
        d = len(self.inertias)
        flow = (self._scale[:, None] * exponential / self._scale)[: 2 * d]
        return flow[:, : 2 * d], flow[:, 2 * d :] @ np.kron(HERMITE_COEFFICIENTS, np.eye(d))

    @cached_property
    def _flow(self) -> tuple[Array, Array]:
        from scipy.linalg import expm

        return self._step_and_gains(expm(self._generator))

    @property
    def step(self) -> Array:
        """Of the states (q, q') of all modes over one sampling interval, (2 d, 2 d)."""
        return self._flow[0]

    @property
    def gains(self) -> Array:
        """From the input's values and slopes (per step) at both ends of an interval, y0, y1, s0, s1, (2 d, 4 d)."""
        return self._flow[1]

    @cached_property
    def _gains_of_modes(self) -> Array:
        """Gains of each decoupled mode, (d, 2, 4)."""
        d = len(self.inertias)
        own = np.arange(d)
        return np.ascontiguousarray(self.gains.reshape(2, d, 4, d)[:, own, :, own])

    def _flow_change(self, d_inertia: Array, d_lag: float) -> tuple[Array, Array]:
        """Directional derivative of step and gains; the system matrix changes in the rows of the rates."""
        from scipy.linalg import expm_frechet

        d, inverse = len(self.inertias), 1 / self.inertias
        d_inverse = -inverse[:, None] * d_inertia * inverse
        change = np.zeros((6 * d, 6 * d))
        change[d : 2 * d, : 3 * d] = self.dt * np.hstack(
            [-d_inverse, -self.lag * d_inverse - d_lag * np.diag(inverse), d_inverse]
        )
        change *= self._scale / self._scale[:, None]
        return self._step_and_gains(np.asarray(expm_frechet(self._generator, change, compute_expm=False), dtype=float))

    def _recurrence(self, start: Array, forcing: Array, found: Array) -> None:
        """Angles and rates (2, d, n) of x_{i+1} = step x_i + forcing_i (d, 2, n - 1), x_0 = (start (d,), 0), into
        `found`.

        As step² = trace step - determinant (Cayley-Hamilton), x_{i+1} - trace x_i + determinant x_{i-1} =
        forcing_i - adjugate forcing_{i-1}: a banded triangular system with three diagonals for each mode.
        """
        from scipy.linalg.lapack import dtbtrs

        d, n = len(self.inertias), forcing.shape[2] + 1
        own = np.zeros((d, 2, n))
        own[:, 0, 0], own[:, :, 1:] = start, forcing
        adjugates, determinants = self._characteristics
        own[:, :, 1:] -= adjugates @ own[:, :, :-1]
        diagonals = np.ones((n, 3)).T
        for mode in range(d):
            diagonals[1], diagonals[2] = -np.trace(adjugates[mode]), determinants[mode]
            found[:, mode] = dtbtrs(diagonals, own[mode].T, uplo="L", diag="U", overwrite_b=True)[0].T

    @cached_property
    def _characteristics(self) -> tuple[Array, Array]:
        """Adjugate (d, 2, 2), of the same trace, and determinant (d,) of each mode's step."""
        d = len(self.inertias)
        own = np.arange(d)
        steps = self.step.reshape(2, d, 2, d)[:, own, :, own]
        traces = np.trace(steps, axis1=1, axis2=2)
        return traces[:, None, None] * np.eye(2) - steps, np.linalg.det(steps)


def _ends(drive: Array) -> Array:
    """Values and slopes (per step) at both ends of each step, y0, y1, s0, s1: (d, 4, n - 1)."""
    slopes = SplineSlopes.of(drive.shape[1]).of_values(drive)
    return np.stack([drive[:, :-1], drive[:, 1:], slopes[:, :-1], slopes[:, 1:]], axis=1)


def _stacked(ends: Array) -> Array:
    """The same with all modes stacked, (4 d, n - 1)."""
    return np.asarray(ends.swapaxes(0, 1).reshape(-1, ends.shape[2]))
