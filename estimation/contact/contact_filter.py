"""Real-time filter for the contact wrench, sample by sample, with a constant known delay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any, NamedTuple, Self, TypeAlias

import casadi as ca
import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from estimation.contact.contact_wrench import CalibratedModel
from estimation.fit import Fit
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.motion import QUATERNION, MotionForm, motion_columns, numbered_names
from estimation.recordings.reading import motion_form
from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.chain.sensor_axes import Axes, contact_gain_at, group_delay
from modeling.codegen.casadi_target import CasadiSample, RecursiveFunction, state_size
from modeling.codegen.fitted_model import sample_inputs, sample_program
from modeling.compiled.symbolic_vector import casadi_expressions
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.kinematics.placement import angular_motion, motion_in_world
from modeling.rig import Rig
from modeling.rigid_body import contact_components
from modeling.space import signals
from modeling.table import Table, Tabular

Array = NDArray[np.float64]

DERIVATIVE_COUNT = 3
"""Value, rate and acceleration."""
POLYNOMIAL_DEGREE = 4
"""The acceleration of a quartic is a parabola, which follows the peaks of a motion; a parabola's is constant."""
FREQUENCIES_PER_LOBE = 8
"""Frequencies per lobe of the frequency response, so that its first -3 dB crossing is not missed."""


@dataclass(frozen=True, kw_only=True)
class LocalPolynomial:
    """The polynomial that fits a window of samples best by least squares (Savitzky-Golay).

    Its value and derivatives in the middle are `kernels` times the 2 `half` + 1 samples. `of_delay` and `of_bandwidth`
    give the longest window for a delay or a bandwidth.

    Parameters
    ----------
    half : int
        Samples on either side of the middle one.
    dt : float
        Sampling interval, s.
    degree : int, optional
        Degree of the polynomial, by default 4.

    Raises
    ------
    InputError
        When the window has too few samples for its polynomial, the degree is below 2, or the step is not positive.

    Notes
    -----
    The kernels are symmetric, so that the phase is linear and the delay `delay` = half dt at every frequency.
    Polynomials up to `degree` are reproduced exactly; by symmetry, value and acceleration are exact for the next odd
    power too, the rate for the next even one.

    Examples
    --------
    >>> import truewrench as tw
    >>> window = tw.LocalPolynomial.of_delay(0.05, dt=0.01)
    >>> window.samples, window.kernels.shape, round(window.bandwidth, 2)
    (11, (3, 11), 16.17)
    >>> value, rate, acceleration = window.kernels @ [(0.01 * i) ** 2 for i in range(11)]  # t², 0.05 s ago
    >>> round(float(value), 4), round(float(rate), 4), round(float(acceleration), 4)
    (0.0025, 0.1, 2.0)
    """

    half: int
    dt: float
    degree: int = POLYNOMIAL_DEGREE

    def __post_init__(self) -> None:
        least = self.degree // 2
        _require(self.degree >= 2, f"degree {self.degree} has no acceleration", "give a degree of at least 2")
        _require(self.dt > 0, f"a step of {self.dt:g} s", "give a positive step")
        samples = f"{2 * self.half + 1} samples do not determine a polynomial of degree {self.degree}"
        _require(2 * self.half + 1 > self.degree, samples, f"wait {(least + self.degree % 2) * self.dt:g} s at least")

    @classmethod
    def of_delay(cls, delay: float, *, dt: float, degree: int = POLYNOMIAL_DEGREE) -> Self:
        """The longest window with a delay of at most `delay` (s)."""
        return cls(half=int(np.floor(delay / dt * (1 + 1e-9))), dt=dt, degree=degree)  # 1e-9: rounding of the ratio

    @classmethod
    def of_bandwidth(cls, frequency: float, *, dt: float, degree: int = POLYNOMIAL_DEGREE) -> Self:
        """The longest window that passes `frequency` (Hz) with at least 1/sqrt(2) of its amplitude.

        Raises InputError for a frequency beyond half the sample rate, or not positive.
        """
        possible = 0 < frequency <= 0.5 / dt
        _require(possible, f"a bandwidth of {frequency:g} Hz", f"give one up to half the sample rate, {0.5 / dt:g} Hz")
        shortest = (degree + 1) // 2
        too_long = next(n for n in count() if cls(half=shortest + 2**n, dt=dt, degree=degree).bandwidth < frequency)
        low, high = shortest, shortest + 2**too_long
        while high - low > 1:
            middle = (low + high) // 2
            fits = cls(half=middle, dt=dt, degree=degree).bandwidth >= frequency
            low, high = (middle, high) if fits else (low, middle)
        return cls(half=low, dt=dt, degree=degree)

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return 2 * self.half + 1

    @property
    def delay(self) -> float:
        """Delay (s) of the results, at every frequency."""
        return self.half * self.dt

    @cached_property
    def kernels(self) -> Array:
        """Rows (3, samples), oldest sample first, that give value, rate and acceleration (per s, s²).

        In Legendre polynomials of the scaled time, -1 to 1, the fit is well conditioned for any window length.
        """
        place = np.arange(-self.half, self.half + 1) / self.half
        fit = np.linalg.pinv(legendre.legvander(place, self.degree))
        basis = np.eye(self.degree + 1)
        middle = np.stack([legendre.legval(0.0, legendre.legder(basis, order)) for order in range(DERIVATIVE_COUNT)])
        return np.asarray(middle @ fit / np.array([self.delay**order for order in range(DERIVATIVE_COUNT)])[:, None])

    @cached_property
    def norms(self) -> Array:
        """Std of value, rate and acceleration (3,) per std of white noise of the samples."""
        return np.asarray(np.linalg.norm(self.kernels, axis=1))

    def gain(self, frequency: ArrayLike, order: int = 0) -> Array:
        """Gain of the derivative of this order relative to the exact one at frequencies (k,) in Hz; real, 1 at zero.

        For a sine of angular frequency w: sum_i kernel_i exp(j w i dt) / (j w)^order, i = -half .. half.
        """
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float))
        ticks = np.arange(-self.half, self.half + 1) * self.dt
        wave = np.sin if order % 2 else np.cos
        sums = wave(np.outer(w, ticks)) @ self.kernels[order] * (-1) ** (order // 2)
        return np.asarray(np.divide(sums, w**order, out=np.ones(len(w)), where=w > 0))

    @cached_property
    def bandwidth(self) -> float:
        """The first frequency (Hz) with a gain of 1/sqrt(2) (-3 dB); half the sample rate without one."""
        grid = np.linspace(0.0, 0.5 / self.dt, FREQUENCIES_PER_LOBE * self.samples)
        below = np.flatnonzero(self.gain(grid) < np.sqrt(0.5))
        if not below.size:
            return float(grid[-1])
        return float(brentq(lambda f: self.gain(f)[0] - np.sqrt(0.5), grid[below[0] - 1], grid[below[0]]))


def _require(holds: bool, what: str, remedy: str) -> None:
    if not holds:
        raise InputError(what=what, where="window", remedy=remedy)


# Model signals as expressions of one row's columns and their time derivatives.


SignalExpressions: TypeAlias = "dict[str, sp.Expr]"

FULL_TURN = 2 * np.pi


class ColumnDerivative(NamedTuple):
    """A time derivative of a column; order 0 is the column itself."""

    column: str
    order: int

    @property
    def symbol(self) -> sp.Symbol:
        """Its symbol in a signal's expression."""
        return sp.Symbol(self.column + "'" * self.order, real=True)


@dataclass(frozen=True, eq=False)
class RowSignals:
    """The signals of a recording (`Recording.signals`), each an expression of derivatives of a row's columns.

    Rates and accelerations are those recorded, else derivatives of the highest recorded order below; without any of
    the sensor origin its acceleration is zero. Columns that are not part of the motion are signals by their own name.
    With an `arm` the signals of its kinematics are symbols until `graphs` computes them from the joints.
    """

    columns: tuple[str, ...]
    form: MotionForm
    signals: SignalExpressions
    arm: Arm | None = None

    @classmethod
    def of(cls, columns: Sequence[str], channels: tuple[str, ...], rig: Rig | None) -> RowSignals:
        """From the names of a row's columns, as in FORMATS.

        Raises InputError when the motion is incomplete, or when joint angles come without kinematics.
        """
        one = ColumnTable(columns={name: np.zeros(1) for name in columns}, where="contact filter", first_row=1)
        form = motion_form(one, channels, rig)
        arm = rig.arm if rig is not None and form is MotionForm.JOINTS else None
        motion = motion_columns(form, 0 if arm is None else arm.joints)
        signals = {name: ColumnDerivative(name, 0).symbol for name in columns if name not in motion}
        if arm is not None:
            signals |= _joint_signals(columns, arm)
        elif form is MotionForm.PLANAR_POSE:
            signals |= _derived(columns, ("phi",), ("dphi",), ("ddphi",)) | _translation(columns, "p", "v", "a", "xy")
        else:
            signals |= _rotation(columns) | _translation(columns, "p", "vp", "ap", "xyz")
        if rig is not None and rig.gravity_direction is not None and arm is None:
            signals = motion_in_world(signals, rig.gravity_direction)
        return cls(tuple(columns), form, signals, arm)

    def graphs(self, model: WrenchModel) -> tuple[tuple[ColumnDerivative, ...], Any, list[Any]]:
        """Column derivatives that a sample of the model needs, their CasADi vector, and the graphs of its signals.

        Raises InputError when it needs signals that a row does not give.
        """
        names = sample_inputs(model)
        self._require(names, model)
        needs_kinematics = self.arm is not None and not set(self.arm.names).isdisjoint(names)
        needed = {symbol.name for name in names for symbol in self.signals[name].free_symbols}
        needed |= set(self._joint_state if needs_kinematics else ())
        candidates = (ColumnDerivative(column, order) for column in self.columns for order in range(3))
        derivatives = tuple(d for d in candidates if d.symbol.name in needed)
        values = ca.SX.sym("derivatives", len(derivatives))
        expressions = {d.symbol: values[i] for i, d in enumerate(derivatives)}
        if self.arm is not None and needs_kinematics:
            state = ca.vertcat(*(expressions[sp.Symbol(name, real=True)] for name in self._joint_state))
            motion = self.arm.function(*ca.vertsplit(state, self.arm.joints))
            expressions |= dict(zip(signals(*self.arm.names), ca.vertsplit(motion), strict=True))
        return derivatives, values, casadi_expressions(expressions, [self.signals[name] for name in names])

    def _require(self, names: Sequence[str], model: WrenchModel) -> None:
        missing = [name for name in names if name not in self.signals]
        if missing:
            affected = [e.id for e in model.effects if set(missing) & set((model.base + e).inputs)]
            by = f" (for {', '.join(affected)})" if affected else ""
            raise InputError(
                what=f"the model needs {', '.join(missing)}{by}, which rows of {', '.join(self.columns)} do not give",
                where="contact filter",
                remedy="give these columns too, or leave the effect out",
            )

    @property
    def _joint_state(self) -> list[str]:
        """Symbol names of q1.., dq1.., ddq1.., in this order."""
        count = 0 if self.arm is None else self.arm.joints
        return [self.signals[name].name for prefix in ("q", "dq", "ddq") for name in numbered_names(prefix, count)]

    def unwrapped(self, row: Array, before: Array) -> Array:
        """A row with the angle unwrapped, or the quaternion's sign aligned, to the row before (already unwrapped).

        The quaternion is also normalised.
        """
        row = row.copy()
        if self.form is MotionForm.PLANAR_POSE:
            i = self.columns.index("phi")
            row[i] -= FULL_TURN * np.round((row[i] - before[i]) / FULL_TURN)
        elif self.form is MotionForm.POSE:
            indices = [self.columns.index(name) for name in QUATERNION]
            size = np.linalg.norm(row[indices])
            row[indices] /= -size if row[indices] @ before[indices] < 0 else size
        return row


def _derived(columns: Sequence[str], *groups: Sequence[str]) -> dict[str, sp.Expr]:
    """Value, rate and acceleration named in the groups: as recorded, or derived from the highest recorded order."""
    derivatives: dict[str, sp.Expr] = {}
    source: tuple[int, Sequence[str]] | None = None
    for order, names in enumerate(groups):
        if all(name in columns for name in names):
            source = order, names
        if source is not None:
            derivatives |= {
                n: ColumnDerivative(c, order - source[0]).symbol for n, c in zip(names, source[1], strict=True)
            }
    return derivatives


def _joint_signals(columns: Sequence[str], arm: Arm) -> SignalExpressions:
    """Expressions of the joints' motion, and symbols for the signals of the arm's kinematics."""
    names = zip(*(numbered_names(prefix, arm.joints) for prefix in ("q", "dq", "ddq")), strict=True)
    joints = {
        name: expression for q, dq, ddq in names for name, expression in _derived(columns, (q,), (dq,), (ddq,)).items()
    }
    return {name: sp.Symbol(name, real=True) for name in arm.names} | joints


def _translation(
    columns: Sequence[str], position: str, velocity: str, acceleration: str, axes: str
) -> SignalExpressions:
    """Motion of the sensor origin; its acceleration is zero when none of it is recorded."""
    groups = [[prefix + axis for axis in axes] for prefix in (position, velocity, acceleration)]
    return dict.fromkeys(groups[2], sp.S.Zero) | _derived(columns, *groups)


def _rotation(columns: Sequence[str]) -> SignalExpressions:
    """Orientation, angular velocity and acceleration; the last two as recorded, else derived."""
    rates, accelerations = ([prefix + axis for axis in "xyz"] for prefix in ("w", "al"))
    components = [[ColumnDerivative(name, order).symbol for name in QUATERNION] for order in range(3)]
    return dict(angular_motion(components)) | _derived(columns, rates, accelerations)


FilterRow = Mapping[str, float] | ArrayLike


class ContactFilter(Tabular):
    """Contact wrench row by row, the real-time counterpart of `compensate`.

    At each sample `update` takes the current motion and reading and gives the contact wrench (p,), N and N m, of the
    environment on the tool, of `delay` seconds ago: in sensor axes, in the plane along x' and y' of the tip. The result
    is None for the first rows, until the window is full and the transfer function's initial transient has
    decayed (`warm_up`). A row with a missing value restarts the filter.

    Parameters
    ----------
    fitted : Fit or CalibratedModel
        The fitted model of the tool; recording-specific effects are dropped.
    columns : sequence of str
        Columns of a row besides the model's channels: motion and auxiliary, named as in FORMATS, SI.
    window : LocalPolynomial
        Window that differentiates the motion and smooths the reading; its `dt` is the sampling interval.
    rig : Rig, optional
        The kinematics that joint angles need.
    zero : array (p,), optional
        The readings' zero of this session, in the channels' units; by default the calibration's biases. Drift that
        depends on a recorded column is added.

    Raises
    ------
    InputError
        When the model needs other signals, its transfer function cannot be run sample by sample, or `zero` is not one
        finite number for each channel.

    Notes
    -----
    One Savitzky-Golay window over all columns gives the motion's value, rate and acceleration and smooths the reading,
    so that prediction and reading have the same delay. The prediction passes the sensor's transfer function before it
    is subtracted from the reading. The contact itself is not deconvolved: the sensor's `group_delay`, relative to the
    motion's clock, adds to `delay`. A sensor that leads the motion makes `delay` longer.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> window = tw.LocalPolynomial.of_delay(0.05, dt=0.01)
    >>> stream = tw.ContactFilter(fit, columns=["q1", "q2", "q3"], window=window, rig=rig)
    >>> stream.columns, stream.warm_up
    (('q1', 'q2', 'q3', 'fx', 'fy', 'tau'), 11)
    >>> results = [stream.update([0, 0, 0.5, 15, 0.2, -1.3]) for _ in range(stream.warm_up)]
    >>> results[0] is None, results[-1].shape
    (True, (3,))
    """

    def __init__(
        self,
        fitted: Fit | CalibratedModel,
        *,
        columns: Sequence[str],
        window: LocalPolynomial,
        rig: Rig | None = None,
        zero: ArrayLike | None = None,
    ) -> None:
        """A filter that has received no row."""
        calibration = fitted if isinstance(fitted, CalibratedModel) else CalibratedModel.of(fitted)
        self.calibration = calibration.without_recording_specific
        self.window = window
        model, theta = self.calibration.model, self.calibration.theta
        biases = len(model.biases)
        self.zero = np.array(theta[:biases] if zero is None else zero, dtype=float)
        if self.zero.shape != (biases,) or not np.isfinite(self.zero).all():
            raise _error(f"a zero {self.zero.tolist()} for {biases} channels", "give one number for each channel")
        self.motion = RowSignals.of(columns, model.channels, rig)
        self.columns = (*self.motion.columns, *model.channels)
        self._program = sample_program(model, theta, window.dt)
        self._derivatives, self._function = self._compiled()
        self._inverse = np.linalg.inv(contact_gain_at(model, theta)[0])
        order = np.array([d.order for d in self._derivatives], dtype=np.intp)
        place = np.array([self.columns.index(d.column) for d in self._derivatives], dtype=np.intp)
        self._order_and_column = order, place
        self.restart()

    def _compiled(self) -> tuple[tuple[ColumnDerivative, ...], Any]:
        """Column derivatives that the model needs, and the CasADi function of one sample.

        From the derivatives, the biases, the reading and the state to the residual, reading minus prediction, and the
        next state.
        """
        model, theta = self.calibration.model, self.calibration.theta
        derivatives, given, graphs = self.motion.graphs(model)
        zero, reading = (ca.SX.sym(name, len(model.channels)) for name in ("zero", "reading"))
        state = ca.SX.sym("state", state_size(self._program))
        values = dict(zip((p.symbol for p in model.parameters), map(ca.SX, theta), strict=True))
        values |= dict(zip((p.symbol for p in model.biases), ca.vertsplit(zero), strict=True))
        values |= dict(zip(signals(*sample_inputs(model)), graphs, strict=True))
        sample = CasadiSample.of(self._program, values, reading, state)
        results = [ca.densify(sample.measured - sample.prediction), ca.densify(sample.next_state)]
        return derivatives, ca.Function("row", [given, zero, reading, state], results)

    # ---------------------------------------------------------------------------------------- running

    def restart(self) -> None:
        """Clear all rows and states."""
        self._step = RecursiveFunction(self._function)
        self._rows = np.zeros((self.window.samples, len(self.columns)))
        self._row_count = 0

    def update(self, row: FilterRow) -> Array | None:
        """The contact wrench (p,), N and N m, `delay` seconds before this row; None during `warm_up`.

        The row is a mapping by name (further names are ignored) or an array in the order of `columns`, SI.
        Raises InputError when a column is missing.
        """
        residual = self._residual(row)
        return None if residual is None else self._inverse @ residual

    def rezero(self, rows: Iterable[FilterRow]) -> ContactFilter:
        """A new filter with the mean zero of these rows, which must be contact-free.

        Raises InputError when they are too few for one result.
        """
        restarted = self._with_zero(self.zero)
        residuals = [r for r in map(restarted._residual, rows) if r is not None]
        if not residuals:
            raise _error(f"no result before row {self.warm_up}", "give more rows without contact")
        return self._with_zero(self.zero + np.mean(residuals, axis=0))

    def _with_zero(self, zero: Array) -> ContactFilter:
        other = copy(self)
        other.zero = zero
        other.restart()
        return other

    def _residual(self, row: FilterRow) -> Array | None:
        """Residual (p,), measured minus predicted, in the channels' units."""
        values = self._values(row)
        if not np.isfinite(values).all():
            self.restart()
            return None
        self._rows[:-1] = self._rows[1:]
        self._rows[-1] = self.motion.unwrapped(values, self._rows[-2] if self._row_count else values)
        self._row_count += 1
        if self._row_count < self.window.samples:
            return None
        moments = self.window.kernels @ self._rows
        reading = np.ascontiguousarray(moments[0, len(self.motion.columns) :])
        (residual,) = self._step(moments[self._order_and_column], self.zero, reading)
        return residual if self._row_count >= self.warm_up else None

    def _values(self, row: FilterRow) -> Array:
        if isinstance(row, Mapping):
            missing = [name for name in self.columns if name not in row]
            if missing:
                raise _error(f"a row without {', '.join(missing)}", f"give {', '.join(self.columns)}")
            return np.array([row[name] for name in self.columns], dtype=float)
        values = np.asarray(row, dtype=float)
        if values.shape != (len(self.columns),):
            raise _error(f"a row of shape {values.shape}", f"give {', '.join(self.columns)}")
        return values

    # --------------------------------------------------------------------------------- properties

    @property
    def delay(self) -> float:
        """Delay (s) of the contact wrench after its reading: half the window, and the wait for a leading sensor."""
        return self.window.delay + self._program.latency * self.window.dt

    @property
    def group_delay(self) -> float:
        """Group delay (s) of the sensor at low frequency, relative to the motion's clock."""
        return group_delay(self.calibration.model, self.calibration.theta)

    @property
    def warm_up(self) -> int:
        """Rows up to and including the first result."""
        return self.window.samples + max(self._program.latency, self._program.settling)

    @property
    def bandwidth(self) -> float:
        """Frequency (Hz) at which the window's gain is 1/sqrt(2) (-3 dB)."""
        return self.window.bandwidth

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of one result under white noise of the calibration's std; the motion is taken as exact.

        Results within one window of each other are correlated.
        """
        spread = self._inverse * (self.calibration.floor * self.window.norms[0])
        return np.asarray(spread @ spread.T)

    @property
    def std(self) -> Array:
        """Standard deviation (p,) of one result, N and N m."""
        return np.sqrt(np.diag(self.covariance))

    def unfollowed(self, frequency: ArrayLike) -> Array:
        """Share (k,) of an inertial load at these frequencies (Hz) that leaks into the contact wrench.

        The difference of the window's gains for the reading (value) and for the highest derivative in use (acceleration
        or rate). Zero when no column is differentiated.
        """
        value = self.window.gain(frequency)
        return np.asarray(value - self.window.gain(frequency, max((d.order for d in self._derivatives), default=0)))

    @property
    def table(self) -> Table:
        """Delay, bandwidth, noise and leakage of inertial loads."""
        space = self.calibration.model.space
        names, units = contact_components(space), space.units
        noise = ", ".join(f"{n} {s:.3g} {u}" for n, s, u in zip(names, self.std, units, strict=True))
        share = 100 * abs(float(self.unfollowed(self.bandwidth / 4)[0]))
        rows = [
            ("delay", f"{self.delay:.6g} s"),
            ("sensor's group delay", f"{self.group_delay:.6g} s"),
            ("first result at row", f"{self.warm_up}"),
            ("bandwidth (-3 dB)", f"{self.bandwidth:.4g} Hz"),
            (f"noise (std), in {Axes.of_contact(space).words(space)}", noise),
            (
                "noise of derived accelerations",
                f"{self.window.norms[2]:.3g} /s² times that of the differentiated column",
            ),
            ("inertial load leaking into contact", f"{share:.2g} % at {self.bandwidth / 4:.3g} Hz"),
        ]
        return Table.of(("contact filter", "value"), rows)


def _error(what: str, remedy: str) -> InputError:
    return InputError(what=what, where="contact filter", remedy=remedy)
