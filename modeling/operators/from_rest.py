"""FromRest: oscillators that start from rest, followed exactly through a cubic spline of their drive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Motion = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class FromRest:
    """inertia_i q_i'' + lag q_i' + q_i = drive_i for d modes; q(0) = drive(0), q'(0) = 0. Series (n, d), step dt (s).

    inertias (d,) in s², positive; lag in s.
    """

    inertias: Array
    lag: float
    dt: float

    def motion(self, drive: Array) -> Motion:
        """q, q' and q'' at the samples.

        On each step the polynomial p that solves the equation for the spline's piece a0 + a1 t + a2 t² + a3 t³ has
        p3 = a3, p2 = a2 - 3 lag p3, p1 = a1 - 2 lag p2 - 6 inertia p3, p0 = a0 - lag p1 - 2 inertia p2, and what the
        state differs from it by goes on as exp(A dt).
        """
        begins, ends = self._states(self._polynomials(drive))
        q, dq = self._recurrence(drive[0], ends - begins @ self._step.T)
        return q, dq, (drive - q - self.lag * dq) / self.inertias

    def change(self, drive: Array, motion: Motion, *, d_drive: Array, d_inertia: Array, d_lag: float) -> Motion:
        """The change of that motion with changes of the drive (n, d), of the inertia (d, d) and of the lag.

        Exact, the change of exp(A dt) included (Al-Mohy and Higham 2009): a tool that rings faster than the samples
        come gets out of phase with itself at once.
        """
        polynomials = self._polynomials(drive)
        p1, p2, p3 = polynomials[1:]
        d_drives = self._pieces(d_drive)
        d3 = d_drives[3]
        d2 = d_drives[2] - 3 * (self.lag * d3 + d_lag * p3)
        d1 = d_drives[1] - 2 * (self.lag * d2 + d_lag * p2) - 6 * (self.inertias * d3 + p3 @ d_inertia.T)
        d0 = d_drives[0] - (self.lag * d1 + d_lag * p1) - 2 * (self.inertias * d2 + p2 @ d_inertia.T)
        d_begins, d_ends = self._states(np.stack([d0, d1, d2, d3]))
        q, dq, ddq = motion
        off = np.hstack([q, dq])[:-1] - self._states(polynomials)[0]
        forcing = d_ends - d_begins @ self._step.T + off @ self._step_change(d_inertia, d_lag).T
        c, dc = self._recurrence(d_drive[0], forcing)
        return c, dc, (d_drive - c - self.lag * dc - d_lag * dq - ddq @ d_inertia.T) / self.inertias

    def _pieces(self, drive: Array) -> Array:
        """Coefficients (4, n - 1, d) of the spline's pieces, the constant first."""
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(np.arange(len(drive)) * self.dt, drive, axis=0).c[::-1])

    def _polynomials(self, drive: Array) -> Array:
        a0, a1, a2, p3 = self._pieces(drive)
        p2 = a2 - 3 * self.lag * p3
        p1 = a1 - 2 * self.lag * p2 - 6 * self.inertias * p3
        return np.stack([a0 - self.lag * p1 - 2 * self.inertias * p2, p1, p2, p3])

    def _states(self, polynomials: Array) -> tuple[Array, Array]:
        """Angles and rates (n - 1, 2 d) at the beginning and at the end of each step."""
        (p0, p1, p2, p3), h = polynomials, self.dt
        ends = [p0 + h * (p1 + h * (p2 + h * p3)), p1 + h * (2 * p2 + 3 * h * p3)]
        return np.hstack([p0, p1]), np.hstack(ends)

    @cached_property
    def _generator(self) -> Array:
        """A dt, with rates divided by the natural frequencies, so that nothing is lost in rounding."""
        frequency = np.diag(1 / np.sqrt(self.inertias)) * self.dt
        return np.block([[np.zeros_like(frequency), frequency], [-frequency, -self.lag * frequency**2 / self.dt]])

    @cached_property
    def _scale(self) -> Array:
        ones = np.ones(2 * len(self.inertias))
        ones[len(self.inertias) :] /= np.sqrt(self.inertias)
        return ones

    @cached_property
    def _step(self) -> Array:
        """exp(A dt), (2 d, 2 d)."""
        from scipy.linalg import expm

        return np.asarray(self._scale[:, None] * expm(self._generator) / self._scale)

    def _step_change(self, d_inertia: Array, d_lag: float) -> Array:
        """Its change; that of A is in the rows of the rates, which the inverse inertia multiplies."""
        from scipy.linalg import expm_frechet

        inverse = 1 / self.inertias
        d_inverse = -inverse[:, None] * d_inertia * inverse
        rates = np.hstack([-d_inverse, -self.lag * d_inverse - d_lag * np.diag(inverse)]) * self.dt
        change = np.vstack([np.zeros_like(rates), rates]) * self._scale / self._scale[:, None]
        moved = expm_frechet(self._generator, change, compute_expm=False)
        return np.asarray(self._scale[:, None] * moved / self._scale)

    def _recurrence(self, start: Array, forcing: Array) -> tuple[Array, Array]:
        """Angles and rates of x_{i+1} = step x_i + forcing_i from (start, 0), mode by mode.

        As step² = trace step - determinant (Cayley-Hamilton), each obeys x_{i+1} - trace x_i + determinant x_{i-1} =
        forcing_i - adjugate forcing_{i-1}.
        """
        from scipy.signal import lfilter

        d = len(self.inertias)
        inputs = np.vstack([np.hstack([start, np.zeros(d)]), forcing])
        found = np.empty_like(inputs)
        for mode in range(d):
            pair = [mode, mode + d]
            step = self._step[np.ix_(pair, pair)]
            trace, determinant = float(np.trace(step)), float(np.linalg.det(step))
            own = inputs[:, pair]
            own[1:] -= inputs[:-1, pair] @ (trace * np.eye(2) - step).T
            found[:, pair] = lfilter([1.0], [1.0, -trace, determinant], own, axis=0)
        return found[:, :d], found[:, d:]
