"""FromRest: oscillators that start from rest, followed exactly through a cubic spline of their drive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

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
        state differs from it by goes on as exp(A dt). That is linear in the spline's values and slopes at both ends.
        """
        y = np.ascontiguousarray(drive.T)
        slopes = _Slopes.of(len(drive)).of_values(y) / self.dt
        ends = (y[:, :-1], y[:, 1:], slopes[:, :-1], slopes[:, 1:])
        forcing = sum(gain[:, :, None] * part for gain, part in zip(self._gains, ends, strict=True))
        q, dq = self._recurrence(y[:, 0], np.asarray(forcing))
        found = (q.T, dq.T, (drive - q.T - self.lag * dq.T) / self.inertias)
        return found

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
        c, dc = (part.T for part in self._recurrence(d_drive[0], forcing.T.reshape(2, len(self.inertias), -1)))
        return c, dc, (d_drive - c - self.lag * dc - d_lag * dq - ddq @ d_inertia.T) / self.inertias

    def _pieces(self, drive: Array) -> Array:
        """Coefficients (4, n - 1, d) of the spline's pieces, the constant first."""
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(np.arange(len(drive)) * self.dt, drive, axis=0).c[::-1])

    @cached_property
    def _gains(self) -> Array:
        """What values y and slopes s of the spline add to angles and rates over a step, (4, 2, d): y0, y1, s0, s1.

        A piece has a0 = y0, a1 = s0, a2 = 3 (y1 - y0) / h² - (2 s0 + s1) / h, a3 = 2 (y0 - y1) / h³ + (s0 + s1) / h².
        """
        d, h = len(self.inertias), self.dt
        pieces = np.array(
            [
                [1, 0, 0, 0],
                [0, 0, 1, 0],
                [-3 / h**2, 3 / h**2, -2 / h, -1 / h],
                [2 / h**3, -2 / h**3, 1 / h**2, 1 / h**2],
            ]
        )
        begins, ends = self._states(self._polynomials_of(np.repeat(pieces[:, :, None], d, axis=2)))
        own = np.arange(d)
        carried = np.stack(
            [begins[:, :d] * self._step[i, own] + begins[:, d:] * self._step[i, own + d] for i in (own, own + d)]
        )
        return np.asarray(ends.reshape(4, 2, d) - carried.transpose(1, 0, 2))

    def _polynomials(self, drive: Array) -> Array:
        return self._polynomials_of(self._pieces(drive))

    def _polynomials_of(self, pieces: Array) -> Array:
        a0, a1, a2, p3 = pieces
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
        """Angles and rates (d, n) of x_{i+1} = step x_i + forcing_i (2, d, n - 1) from (start (d,), 0), mode by mode.

        As step² = trace step - determinant (Cayley-Hamilton), each obeys x_{i+1} - trace x_i + determinant x_{i-1} =
        forcing_i - adjugate forcing_{i-1}.
        """
        from scipy.signal import lfilter

        d = len(self.inertias)
        inputs = np.zeros((2, d, forcing.shape[2] + 1))
        inputs[0, :, 0], inputs[:, :, 1:] = start, forcing
        found = np.empty_like(inputs)
        for mode in range(d):
            pair = [mode, mode + d]
            step = self._step[np.ix_(pair, pair)]
            trace, determinant = float(np.trace(step)), float(np.linalg.det(step))
            own = inputs[:, mode].copy()
            own[:, 1:] -= (trace * np.eye(2) - step) @ inputs[:, mode, :-1]
            found[:, mode] = lfilter([1.0], [1.0, -trace, determinant], own, axis=1)
        return found[0], found[1]


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Slopes of the cubic spline through n values one step apart, by the factors of its tridiagonal system.

    s_{i-1} + 4 s_i + s_{i+1} = 3 (y_{i+1} - y_{i-1}) inside; the third derivative does not jump at the first and last
    inner knots, s_0 + 2 s_1 = (5 (y_1 - y_0) + y_2 - y_1) / 2 and alike at the end (de Boor, A Practical Guide to
    Splines, 1978, IV): SciPy's `CubicSpline`, its factors kept.
    """

    factors: tuple[Array, ...]

    @classmethod
    def of(cls, count: int) -> _Slopes:
        """For n >= 4 values; the same when asked again."""
        return _factored(count)

    def of_values(self, y: Array) -> Array:
        """(d, n) of values (d, n), per step."""
        from scipy.linalg.lapack import dgttrs

        right = np.empty_like(y)
        right[:, 1:-1] = 3 * (y[:, 2:] - y[:, :-2])
        right[:, 0] = (5 * (y[:, 1] - y[:, 0]) + y[:, 2] - y[:, 1]) / 2
        right[:, -1] = (5 * (y[:, -1] - y[:, -2]) + y[:, -2] - y[:, -3]) / 2
        return np.asarray(dgttrs(*self.factors, right.T)[0].T)


@lru_cache(maxsize=8)
def _factored(count: int) -> _Slopes:
    from scipy.linalg.lapack import dgttrf

    lower, middle, upper = np.ones(count - 1), np.full(count, 4.0), np.ones(count - 1)
    middle[[0, -1]], upper[0], lower[-1] = 1.0, 2.0, 2.0
    return _Slopes(tuple(dgttrf(lower, middle, upper)[:5]))
