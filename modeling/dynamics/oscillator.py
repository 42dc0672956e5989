"""Exact response of a linear second-order system with constant coefficients to a sampled input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import eigh, expm, expm_frechet
from scipy.linalg.lapack import dgbsv, dpttrf, dpttrs, dtbtrs

from modeling.dynamics.motion_record import TimeBase
from modeling.errors import InputError

Array = NDArray[np.float64]

# Cubic spline through equidistant values: SciPy's `CubicSpline`, whose import takes a sixth of a `diagnose`.


def interpolated(values: Array, factor: int, count: int) -> Array:
    """The spline through values (d, n), n >= 4, at `count` places 1 / `factor` intervals apart, from the first on."""
    slopes = SplineSlopes.of(values.shape[1]).of_values(values)
    places = np.arange(count) / factor
    before = np.minimum(places.astype(int), values.shape[1] - 2)
    fraction, rise = places - before, np.diff(values)[:, before]
    start, end = slopes[:, before], slopes[:, before + 1]
    quadratic = 3 * rise - 2 * start - end
    return np.asarray(
        values[:, before] + fraction * (start + fraction * (quadratic + fraction * (start + end - 2 * rise)))
    )


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
        first = (5 * (y[:, 1] - y[:, 0]) + y[:, 2] - y[:, 1]) / 2
        last = (5 * (y[:, -1] - y[:, -2]) + y[:, -2] - y[:, -3]) / 2
        right = 3 * (y[:, 2:] - y[:, :-2])
        right[:, 0] -= first
        right[:, -1] -= last
        slopes = np.empty_like(y)
        slopes[:, 1:-1] = dpttrs(*self.factors, right.T, overwrite_b=True)[0].T
        slopes[:, 0], slopes[:, -1] = first - 2 * slopes[:, 1], last - 2 * slopes[:, -2]
        return slopes


@lru_cache(maxsize=8)
def _factored(count: int) -> SplineSlopes:
    middle = np.full(count - 2, 4.0)
    middle[[0, -1]] = 2.0
    return SplineSlopes(dpttrf(middle, np.ones(count - 3))[:2])


# Exact response of second-order modes to a cubic-spline input, from static equilibrium.


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
        motion = np.empty((3, *drive.shape))
        self._recurrence(drive[:, 0], self._gains_of_modes @ _ends(drive), motion[:2])
        return self._accelerated(motion, drive)

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
        change = np.empty(motion.shape)
        self._recurrence(d_drive[:, 0], forcing.swapaxes(0, 1), change[:2])
        return self._accelerated(change, d_drive - d_lag * motion[1] - d_inertia @ motion[2])

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
        generator = np.zeros((6 * d, 6 * d))
        generator[:d, d : 2 * d] = generator[d : 2 * d, 2 * d : 3 * d] = frequency
        generator[d : 2 * d, :d] = -frequency
        generator[d : 2 * d, d : 2 * d] = -self.lag * frequency**2 / self.dt
        generator[2 * d : 5 * d, 3 * d :] = np.eye(3 * d)
        return generator

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
        modes = np.arange(d)
        return np.ascontiguousarray(self.gains.reshape(2, d, 4, d)[:, modes, :, modes])

    def _flow_change(self, d_inertia: Array, d_lag: float) -> tuple[Array, Array]:
        """Directional derivative of step and gains; the system matrix changes in the rows of the rates."""
        d, inverse = len(self.inertias), 1 / self.inertias
        d_inverse = -inverse[:, None] * d_inertia * inverse
        change = np.zeros((6 * d, 6 * d))
        change[d : 2 * d, : 3 * d] = self.dt * np.hstack(
            [-d_inverse, -self.lag * d_inverse - d_lag * np.diag(inverse), d_inverse]
        )
        change *= self._scale / self._scale[:, None]
        return self._step_and_gains(np.asarray(expm_frechet(self._generator, change, compute_expm=False), dtype=float))

    def _recurrence(self, start: Array, forcing: Array, out: Array) -> None:
        """Angles and rates (2, d, n) of x_{i+1} = step x_i + forcing_i (d, 2, n - 1), x_0 = (start (d,), 0), in `out`.

        As step² = trace step - determinant (Cayley-Hamilton), x_{i+1} - trace x_i + determinant x_{i-1} =
        forcing_i - adjugate forcing_{i-1}: a banded triangular system with three diagonals for each mode.
        """
        d, n = len(self.inertias), forcing.shape[2] + 1
        forced = np.zeros((d, 2, n))
        forced[:, 0, 0], forced[:, :, 1:] = start, forcing
        adjugates, determinants = self._characteristics
        forced[:, :, 1:] -= adjugates @ forced[:, :, :-1]
        diagonals = np.ones((n, 3)).T
        for mode in range(d):
            diagonals[1], diagonals[2] = -np.trace(adjugates[mode]), determinants[mode]
            out[:, mode] = dtbtrs(diagonals, forced[mode].T, uplo="L", diag="U", overwrite_b=True)[0].T

    @cached_property
    def _characteristics(self) -> tuple[Array, Array]:
        """Adjugate (d, 2, 2), of the same trace, and determinant (d,) of each mode's step."""
        d = len(self.inertias)
        modes = np.arange(d)
        steps = self.step.reshape(2, d, 2, d)[:, modes, :, modes]
        traces = np.trace(steps, axis1=1, axis2=2)
        return traces[:, None, None] * np.eye(2) - steps, np.linalg.det(steps)


def _ends(drive: Array) -> Array:
    """Values and slopes (per step) at both ends of each step, y0, y1, s0, s1: (d, 4, n - 1)."""
    slopes = SplineSlopes.of(drive.shape[1]).of_values(drive)
    return np.stack([drive[:, :-1], drive[:, 1:], slopes[:, :-1], slopes[:, 1:]], axis=1)


def _stacked(ends: Array) -> Array:
    """The same with all modes stacked, (4 d, n - 1)."""
    return np.asarray(ends.swapaxes(0, 1).reshape(-1, ends.shape[2]))


# Linear equations of the states of second-order modes over a record, as one banded system.


@dataclass(frozen=True, eq=False)
class TransientEquations:
    """K_i q_i + C_i q_i' + M_i q_i'' = right_i at each sample i, for the response q of d modes to an input y.

    As q'' = (y - lag q' - q) / inertia, the input is y_i = E_i x_i + W_i^-1 right_i with the state x = (q, q') and
    W = M / inertia. Unknown are state and spline slope s of each sample; each step's state, the spline's equations and
    the start couple neighbours alone.

    response   the modes' response to a cubic-spline input
    by_state   E (n, d, 2 d)
    by_right   W^-1 (n, d, d)
    """

    response: TransientResponse
    by_state: Array
    by_right: Array

    @classmethod
    def of(cls, response: TransientResponse, stiffness: Array, damping: Array, mass: Array) -> TransientEquations:
        """With K, C and M (n, d, d) of n >= 4 samples. Raises LinAlgError where an M is singular."""
        weight = mass / response.inertias
        by_right = np.asarray(np.linalg.inv(weight), dtype=np.float64)
        weight_of_state = np.concatenate([weight - stiffness, response.lag * weight - damping], axis=2)
        return cls(response, by_right @ weight_of_state, by_right)

    @staticmethod
    def stored_numbers(count: int, modes: int) -> int:
        """Floats of the banded matrix of so many samples and modes."""
        return count * 3 * modes * _Blocks.rows(3 * modes)

    def inputs(self, rights: Array) -> Array:
        """The inputs y (k, d, n) for right sides (k, d, n). Raises LinAlgError where there is none."""
        of_rights = np.asarray(np.einsum("nij,kjn->kni", self.by_right, rights))
        matrix, bands = self._matrix()
        sides = self._right_sides(of_rights).reshape(len(rights), -1)
        _, _, solved, failed = dgbsv(bands, bands, matrix, sides.T, overwrite_ab=True, overwrite_b=True)
        if failed:
            raise np.linalg.LinAlgError("singular equations of a transient")
        states = solved.T.reshape(len(rights), len(self.by_state), -1)[:, :, : self.by_state.shape[2]]
        return np.asarray(np.moveaxis(np.einsum("nij,knj->kni", self.by_state, states) + of_rights, 2, 1))

    def _right_sides(self, inputs: Array) -> Array:
        """Right sides (k, n, 3 d) of states and slopes, from those inputs (k, n, d) that no state contributes to."""
        d = inputs.shape[2]
        before, after = self.response.gains[:, :d], self.response.gains[:, d : 2 * d]
        sides = np.empty((*inputs.shape[:2], 3 * d))
        sides[:, 0, :d], sides[:, 0, d : 2 * d] = inputs[:, 0], 0.0
        sides[:, 1:, : 2 * d] = inputs[:, :-1] @ before.T + inputs[:, 1:] @ after.T
        sides[:, 1:-1, 2 * d :] = 3 * (inputs[:, 2:] - inputs[:, :-2])
        sides[:, 0, 2 * d :] = 12 * (inputs[:, 1] - inputs[:, 0])
        sides[:, -1, 2 * d :] = 12 * (inputs[:, -1] - inputs[:, -2])
        return sides

    def _matrix(self) -> tuple[Array, int]:
        """Matrix in the band storage of `dgbsv`, and its number of bands on each side."""
        d = self.by_state.shape[1]
        blocks = _Blocks.empty(len(self.by_state), 3 * d)
        self._add_steps(blocks)
        self._add_slopes(blocks)
        return blocks.bands.reshape(-1, blocks.bands.shape[2]).T, blocks.width

    def _add_steps(self, blocks: _Blocks) -> None:
        """x_0 = (y_0, 0), and x_i = step x_{i-1} + gains (y_{i-1}, y_i, s_{i-1}, s_i)."""
        d, by_state = self.by_state.shape[1], self.by_state
        before, after, slope_before, slope_after = np.split(self.response.gains, 4, axis=1)
        start = np.eye(2 * d)
        start[:d] -= by_state[0]
        blocks.add(slice(0, 1), 0, (0, 0), start)
        blocks.add(slice(1, None), 0, (0, 0), np.eye(2 * d) - after @ by_state[1:])
        blocks.add(slice(1, None), 0, (0, 2 * d), -slope_after)
        blocks.add(slice(0, -1), 1, (0, 0), -self.response.step - before @ by_state[:-1])
        blocks.add(slice(0, -1), 1, (0, 2 * d), -slope_before)

    def _add_slopes(self, blocks: _Blocks) -> None:
        """Equations of the spline's slopes (`SplineSlopes`); at the ends six times the first less the second.

        That is 5 s_0 + 8 s_1 - s_2 = 12 (y_1 - y_0), and its mirror image.
        """
        last, by_state = len(self.by_state) - 1, self.by_state
        for offset, of_slope, of_input in ((-1, 1, -3), (0, 4, 0), (1, 1, 3)):
            inside = slice(1 - offset, last - offset)
            self._add_slope_terms(blocks, inside, offset, of_slope, of_input * by_state[inside])
        for end, side in ((0, 1), (last, -1)):
            for steps, of_slope, of_input in ((0, 5, 12), (1, 8, -12), (2, -1, 0)):
                place = slice(end + side * steps, end + side * steps + 1)
                self._add_slope_terms(blocks, place, -side * steps, of_slope, side * of_input * by_state[place])

    def _add_slope_terms(self, blocks: _Blocks, samples: slice, offset: int, of_slope: int, of_state: Array) -> None:
        """Terms of the slopes and states at `samples`, in the slope equations so many samples later."""
        d = self.by_state.shape[1]
        if of_state.any():
            blocks.add(samples, offset, (2 * d, 0), of_state)
        for mode in range(2 * d, 3 * d):
            blocks.add(samples, offset, (mode, mode), np.array([[of_slope]]))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """A square matrix of (size, size) blocks, one row and column of them for each sample, in band storage.

    bands  (n, size, 3 width + 1): for each column its entries from `width` above to `width` below the diagonal, after
           `width` entries that the factorisation fills
    """

    bands: Array
    size: int
    width: int

    @classmethod
    def empty(cls, count: int, size: int) -> _Blocks:
        return cls(np.zeros((count, size, cls.rows(size))), size, 2 * size)

    @staticmethod
    def rows(size: int) -> int:
        """Rows of the band storage for blocks of this size, which are coupled with the next but one."""
        return 3 * 2 * size + 1

    def add(self, samples: slice, offset: int, corner: tuple[int, int], entries: Array) -> None:
        """Add entries ((m,) rows, columns) of the blocks in the columns of `samples`, so many rows of blocks below.

        `corner` is their first row and column in the block; other entries of their rows' range are left.
        """
        row, column = corner
        for number in range(entries.shape[-1]):
            first = 2 * self.width + offset * self.size + row - column - number
            self.bands[samples, column + number, first : first + entries.shape[-2]] += entries[..., number]


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
        by_modes = [block @ self.modes for block in np.split(by_response, 3, axis=2)]
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
