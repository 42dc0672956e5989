"""Motion of a recording: its columns and their derivatives, and the signals that are inputs of a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.differentiation import (
    Derivatives,
    SplineTimes,
    TrueSamples,
    fourier_derivatives,
    fourier_or_spline_derivatives,
    spline_derivatives,
)
from estimation.recordings.repeat_motion import differing_columns, motion_difference
from modeling.kinematics.arm import Arm
from modeling.kinematics.placement import motion_in_world
from modeling.rig import Rig
from modeling.rigid_body import Load

Array = NDArray[np.float64]

QUATERNION = ("qx", "qy", "qz", "qw")
CLOCK_OFFSET = "clock_offset"
"""Column that an import writes where it estimated the offset of the wrench's clock, s, the same in all rows."""
MIN_POSES = 3
"""At rest: with fewer, weight and zero of three channels are collinear."""


class MotionForm(Enum):
    """Form in which the motion was recorded; the value lists the columns that make it complete."""

    JOINTS = "q1..qn"
    PLANAR_POSE = "phi"
    POSE = "qx, qy, qz, qw"


@dataclass(frozen=True, eq=False)
class MotionColumns:
    """Columns that were sampled together, with their derivatives, which are derived once.

    columns     (n,) each by name, SI, as read
    time        (n,) uniform, s, from 0 on in every repeat; None when every row is a static pose
    repeats     how often the motion was run, with n / repeats samples each
    continuous  whether the repeats follow each other without a pause
    derivatives what was derived so far, by the columns that it comes from
    held        what `true_samples` has found so far, by the columns' names
    instants    (n,) s, when each static pose was taken; None where that is not known
    """

    columns: Mapping[str, Array]
    time: Array | None
    repeats: int = 1
    continuous: bool = True
    derivatives: dict[tuple[str, ...], Derivatives] = field(default_factory=dict)
    held: dict[tuple[str, ...], TrueSamples | None] = field(default_factory=dict)
    instants: Array | None = None

    @property
    def samples(self) -> int:
        """The number of rows n."""
        return len(next(iter(self.columns.values())))

    @property
    def samples_per_repeat(self) -> int:
        """Rows in one repeat, n when there is only one."""
        return self.samples // self.repeats

    @property
    def dt(self) -> float | None:
        """Sampling interval in s; None for static poses."""
        return None if self.time is None else float(self.time[1] - self.time[0])

    @property
    def at_rest(self) -> bool:
        """Whether every row is a static pose."""
        return self.time is None

    def averaged(self, series: Array) -> Array:
        """Series (n, k) averaged over the repeats, the average repeated to n samples."""
        return self._tiled(self._mean(series))

    def differentiated(
        self, series: Array, names: Sequence[str] = (), *, antiperiodic: bool = False, held_with: Sequence[str] = ()
    ) -> Derivatives:
        """Series (n, k) of the motion and its first two derivatives, as far as its noise allows; zero if static.

        `names` are the columns that the series comes from, which is derived once then; columns `held_with` them, by
        default the same, show which of their samples are true.
        """
        key = tuple(names)
        if not key or key not in self.derivatives:
            derivatives = self._differentiated(series, held_with or names, antiperiodic)
            if not key:
                return derivatives
            self.derivatives[key] = derivatives
        return self.derivatives[key]

    def drawn(self, rng: np.random.Generator, count: int) -> MotionColumns:
        """`count` runs with motions at random from what the samples leave open, one after another.

        Of the `derivatives` so far; other columns are in every run as they were recorded, and columns are held where
        these are.
        """
        assert self.time is not None  # static poses are not smoothed
        times, span = np.arange(self.samples) * np.float64(self.dt or 0.0), self.samples * (self.dt or 0.0)
        splines = {key: d.spline for key, d in self.derivatives.items() if d.spline is not None}
        innovations = [[spline.innovations(rng) for spline in splines.values()] for _ in range(count)]
        draws = {
            key: SplineTimes.of(spline, times).derivatives(spline.drawn(*each)).one_after_another(count)
            for (key, spline), each in zip(splines.items(), zip(*innovations, strict=True), strict=True)
        }
        return MotionColumns(
            columns={name: np.tile(column, count) for name, column in self.columns.items()},
            time=np.concatenate([self.time + i * span for i in range(count)]),
            repeats=self.repeats,
            continuous=self.continuous,
            derivatives=draws,
            held=dict(self.held),
        )

    def _differentiated(self, series: Array, names: Sequence[str], antiperiodic: bool) -> Derivatives:
        series = self._rebuilt(series, names)
        true = self.true_samples(names) if names else None
        mean = self._mean(series)
        if self.dt is None:
            zero = np.zeros_like(mean)
            fit = Derivatives(value=mean, first=zero, second=zero, score=np.zeros(mean.shape[1]))
        elif self.repeats == 1:
            fit = spline_derivatives(mean, self.dt, true)
        else:
            differentiate = fourier_derivatives if self.continuous else fourier_or_spline_derivatives
            fit = differentiate(mean, self.dt, antiperiodic=antiperiodic)
        value, first, second = map(self._tiled, (fit.value, fit.first, fit.second))
        spline = fit.spline if self.repeats == 1 else None
        return replace(fit, value=value, first=first, second=second, spline=spline)

    def _rebuilt(self, series: Array, names: Sequence[str]) -> Array:
        """A series (n, k) of repeats from its true samples where columns are held, else as it is."""
        true = self.true_samples(names) if names and self.repeats > 1 else None
        return series if true is None or self.dt is None else spline_derivatives(series, self.dt, true).value

    def true_samples(self, names: Sequence[str]) -> TrueSamples | None:
        """The samples behind columns that are held together; None where every row has a new value.

        Of separate runs the columns are taken as they are.
        """
        if self.dt is None or not self.continuous:
            return None
        key = tuple(names)
        if key not in self.held:
            self.held[key] = TrueSamples.of((self.columns[name] for name in names), self.dt, self.samples)
        return self.held[key]

    def given(self, names: Sequence[str]) -> Array | None:
        """Columns of these names, (n, k), averaged over the repeats; None for static poses or when one is missing."""
        if self.at_rest or not all(name in self.columns for name in names):
            return None
        held = self.true_samples(names) is not None
        return self.differentiated(self.stack(names), names).value if held else self.averaged(self.stack(names))

    def stack(self, names: Sequence[str]) -> Array:
        """Columns of these names as recorded, (n, k)."""
        return np.stack([self.columns[name] for name in names], axis=1)

    def _mean(self, series: Array) -> Array:
        """Series (n, k) averaged over the repeats, of one repeat."""
        return np.asarray(series.reshape(self.repeats, self.samples_per_repeat, -1).mean(axis=0))

    def _tiled(self, period: Array) -> Array:
        return np.tile(period, (self.repeats, 1))


@dataclass(frozen=True, eq=False)
class ColumnsOfRepeats(MotionColumns):
    """Columns smoothed in each repeat: the mean over the repeats and what each adds to it."""

    def averaged(self, series: Array) -> Array:
        """Series (n, k) of the motion in each repeat, smoothed as what is differentiated."""
        return self.differentiated(series).value

    def _differentiated(self, series: Array, names: Sequence[str], antiperiodic: bool) -> Derivatives:
        assert self.dt is not None  # static poses have no motion of their own
        mean, rebuilt = super()._differentiated(series, names, antiperiodic), self._rebuilt(series, names)
        added = motion_difference(
            rebuilt, mean.value, self.repeats, self.dt, continuous=self.continuous, antiperiodic=antiperiodic
        )
        value, first, second = mean.value + added.value, mean.first + added.first, mean.second + added.second
        return replace(mean, value=value, first=first, second=second)


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a recording: its columns, their form, and the signals that are inputs of a model.

    rig         the rig with its kinematics and its base; None without one
    loads       what moved beside the tool, or instead of it
    """

    recorded: MotionColumns
    form: MotionForm
    rig: Rig | None = None
    loads: tuple[Load, ...] = ()

    @property
    def arm(self) -> Arm | None:
        """Kinematics from the joints to the sensor; None when the motion was recorded as poses."""
        return self.rig.arm if self.rig is not None and self.form is MotionForm.JOINTS else None

    @property
    def joints(self) -> int:
        """Number of recorded joints, 0 when the motion was recorded as poses."""
        return 0 if self.arm is None else self.arm.joints

    @property
    def auxiliary(self) -> tuple[str, ...]:
        """Columns that are not part of the motion, such as a temperature."""
        used = motion_columns(self.form, self.joints)
        return tuple(name for name in self.recorded.columns if name not in used and name != CLOCK_OFFSET)

    @cached_property
    def signals(self) -> Mapping[str, Array]:
        """Inputs of a model by name, each (n,), as far as this recording can give them; derived once.

        Plane: phi, dphi, ddphi (rad, /s, /s²), px, py, vx, vy, ax, ay of the sensor origin in the world (m).
        Six axes: qx, qy, qz, qw (sensor in the world), wx.., alx.. in the sensor frame (rad/s, rad/s²), px..,
        vpx.., apx.. in the world (m). Both: q1.., dq1.., ddq1.. of a recording with joint angles.
        Always `order`, 0, 1, 2, .. as recorded, and the auxiliary columns; `time` in s unless the poses are static.
        Accelerations are kinematic, without gravity. Motion is averaged over repeats; that of each repeat, where they
        differ beyond noise, is in `own_motion.signals`. Without a position or an
        acceleration the sensor origin's acceleration is taken as zero; in static poses all velocities are zero.
        """
        derive = {
            MotionForm.JOINTS: _joint_motion,
            MotionForm.PLANAR_POSE: _planar_motion,
            MotionForm.POSE: _spatial_motion,
        }
        signals = {name: self.recorded.columns[name] for name in self.auxiliary}
        signals |= {"order": np.arange(self.recorded.samples, dtype=float)}
        if self.recorded.time is not None:
            signals["time"] = self.recorded.time
        return self._in_world(signals | derive[self.form](self))

    @cached_property
    def world_columns(self) -> Mapping[str, Array]:
        """The columns with pose and motion in the world, as recorded where the base stands upright."""
        return self._in_world(self.recorded.columns)

    def _in_world(self, motion: Mapping[str, Array]) -> Mapping[str, Array]:
        """Motion from base axes to the world; that of joints is in the world, by the arm."""
        direction = None if self.rig is None or self.form is MotionForm.JOINTS else self.rig.gravity_direction
        return motion if direction is None else motion_in_world(motion, direction)

    @cached_property
    def model_signals(self) -> ModelSignals:
        """The signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record or the order of poses."""
        return ModelSignals(self)

    @property
    def is_of_repeats(self) -> bool:
        """Whether the signals are the motion of each repeat, not their mean."""
        return isinstance(self.recorded, ColumnsOfRepeats)

    @cached_property
    def of_each_repeat(self) -> Motion | None:
        """The motion of each repeat; None where the repeats are equal within noise."""
        recorded = self.recorded
        if recorded.repeats == 1 or recorded.dt is None or self.is_of_repeats:
            return None
        if not differing_columns(measured_motion(self), recorded.repeats, continuous=recorded.continuous).any():
            return None
        each_repeat = ColumnsOfRepeats(recorded.columns, recorded.time, recorded.repeats, recorded.continuous)
        return replace(self, recorded=each_repeat)


class ModelSignals(Mapping[str, Array]):
    """The signals (n,) of a motion by name, auxiliary ones smoothed, each with its first use.

    Most models take no temperature or current, and smoothing one takes as long as differentiating a joint's angle.
    """

    def __init__(self, motion: Motion) -> None:
        recorded = motion.recorded
        progress = np.linspace(-1.0, 1.0, recorded.samples)
        if recorded.instants is not None:
            progress = np.interp(recorded.instants, recorded.instants[[0, -1]], progress[[0, -1]])
        self._unsmoothed = {**motion.signals, "progress": progress}
        self._smoothed: dict[str, Array] = {}
        self._dt = recorded.dt

        def changes(name: str) -> bool:
            return bool(np.ptp(recorded.columns[name]) > 0)

        self._auxiliary = frozenset() if self._dt is None else frozenset(filter(changes, motion.auxiliary))

    def __getitem__(self, name: str) -> Array:
        series = self._unsmoothed[name]
        if name not in self._auxiliary or self._dt is None:
            return series
        if name not in self._smoothed:
            self._smoothed[name] = spline_derivatives(series[:, None], self._dt).value[:, 0]
        return self._smoothed[name]

    def __contains__(self, name: object) -> bool:
        return name in self._unsmoothed

    def __iter__(self) -> Iterator[str]:
        return iter(self._unsmoothed)

    def __len__(self) -> int:
        return len(self._unsmoothed)


def numbered_names(prefix: str, joints: int) -> tuple[str, ...]:
    """Names prefix1 .. prefixn."""
    return tuple(f"{prefix}{j}" for j in range(1, joints + 1))


def motion_columns(form: MotionForm, joints: int = 0) -> tuple[str, ...]:
    """Every column that a form of motion uses, the optional ones included."""
    if form is MotionForm.JOINTS:
        return numbered_names("q", joints) + numbered_names("dq", joints) + numbered_names("ddq", joints)
    if form is MotionForm.PLANAR_POSE:
        return ("phi", "dphi", "ddphi", "px", "py", "vx", "vy", "ax", "ay")
    vectors = [p + axis for p in ("w", "al", "p", "vp", "ap") for axis in "xyz"]
    return (*QUATERNION, *vectors)


def _unit_quaternions(motion: Motion) -> Array:
    """The recorded orientation (n, 4), x y z w, normalised, without jumps between q and -q."""
    recorded = motion.recorded.stack(QUATERNION).reshape(motion.recorded.repeats, -1, 4)
    unit = np.stack([_without_sign_flips(run) for run in recorded])
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    facing = np.sum(unit * unit[:1], axis=(1, 2), keepdims=True)
    aligned: Array = (unit * np.where(facing < 0, -1.0, 1.0)).reshape(-1, 4)
    return aligned


def _without_sign_flips(quaternions: Array) -> Array:
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 0, 1.0, -1.0)
    return quaternions * signs[:, None]


def measured_motion(motion: Motion) -> Array:
    """Every recorded column of the motion (n, k), angles and quaternions without jumps."""
    used = [name for name in motion_columns(motion.form, motion.joints) if name in motion.recorded.columns]
    parts = [_ramp_and_periodic_angle(motion)[1]] if "phi" in used else []
    parts += [_unit_quaternions(motion)] if "qw" in used else []
    others = [name for name in used if name not in ("phi", *QUATERNION)]
    return np.concatenate([*parts, *([motion.recorded.stack(others)] if others else [])], axis=1)


# -------------------------------------------------------------------------------------------- signals


def _rates(
    motion: Motion,
    value: Array,
    names: Sequence[str],
    first: Sequence[str],
    second: Sequence[str],
    held_with: Sequence[str] = (),
) -> Derivatives:
    """The motion (n, k) of columns `names` with its rates: as recorded under `first` and `second`, else derived."""
    derived = motion.recorded.differentiated(value, names, held_with=held_with)
    rate, acceleration = motion.recorded.given(first), motion.recorded.given(second)
    if acceleration is None:
        of_rate = motion.recorded.differentiated(motion.recorded.stack(first), first) if rate is not None else None
        acceleration = derived.second if of_rate is None else of_rate.first
    rate = derived.first if rate is None else rate
    return replace(derived, first=rate, second=acceleration)


def _named(names: Sequence[str], series: Array) -> dict[str, Array]:
    return dict(zip(names, series.T, strict=True))


def _joint_motion(motion: Motion) -> dict[str, Array]:
    """Poses of the sensor from joint angles by the arm's kinematics (in the plane 22.2)."""
    names = [numbered_names(prefix, motion.joints) for prefix in ("q", "dq", "ddq")]
    # Each joint by itself: a log may hold the velocity of some joints only.
    rates = [
        _rates(motion, motion.recorded.stack([q]), [q], [dq], [ddq], names[0])
        for q, dq, ddq in zip(*names, strict=True)
    ]
    q, dq, ddq = (
        np.concatenate([getattr(rate, order) for rate in rates], axis=1) for order in ("value", "first", "second")
    )
    pose = {} if motion.arm is None else motion.arm.pose(q, dq, ddq)
    joints = (_named(name, series) for name, series in zip(names, (q, dq, ddq), strict=True))
    return {key: value for series_of_joints in joints for key, value in series_of_joints.items()} | pose


def _planar_motion(motion: Motion) -> dict[str, Array]:
    ramp, phi = _ramp_and_periodic_angle(motion)
    angle = _rates(motion, phi, ["phi"], ["dphi"], ["ddphi"])
    signals = {"phi": angle.value[:, 0] + ramp, "dphi": angle.first[:, 0], "ddphi": angle.second[:, 0]}
    if motion.recorded.dt is not None and "dphi" not in motion.recorded.columns:
        signals["dphi"] = signals["dphi"] + (ramp[1] - ramp[0]) / motion.recorded.dt
    return signals | _translation(motion, ("px", "py"), ("vx", "vy"), ("ax", "ay"))


def _ramp_and_periodic_angle(motion: Motion) -> tuple[Array, Array]:
    """phi as a ramp of whole turns per period (n,) and its periodic part (n, 1), in rad."""
    phi = motion.recorded.columns["phi"].reshape(motion.recorded.repeats, -1)
    zero = np.zeros(motion.recorded.samples)
    if motion.recorded.at_rest:
        # Poses in any order: only whole turns between repeats of the same pose are removed.
        return zero, np.unwrap(phi, axis=0).reshape(-1, 1)
    phi = np.unwrap(phi, axis=1)
    phi = phi - 2 * np.pi * np.round((phi[:, :1] - phi[0, 0]) / (2 * np.pi))
    if motion.recorded.repeats == 1 or not motion.recorded.continuous:
        return zero, phi.reshape(-1, 1)
    turns = np.round((phi[0, -1] - phi[0, 0]) / (2 * np.pi))
    ramp = 2 * np.pi * turns * np.arange(phi.shape[1]) / phi.shape[1]
    return np.tile(ramp, motion.recorded.repeats), (phi - ramp).reshape(-1, 1)


def _spatial_motion(motion: Motion) -> dict[str, Array]:
    signals = _rotation(motion)
    position, velocity, acceleration = (tuple(p + axis for axis in "xyz") for p in ("p", "vp", "ap"))
    return signals | _translation(motion, position, velocity, acceleration)


def _rotation(motion: Motion) -> dict[str, Array]:
    """Orientation q, angular velocity and acceleration in the sensor frame.

    With s the smoothed components, q = s / |s|; conj(q) dq and conj(s) ds / |s|² differ by a scalar, so
    omega = 2 vec(conj(s) ds) / |s|², and since conj(ds) ds is a scalar too,
    alpha = 2 vec(conj(s) dds) / |s|² - 2 (s . ds) / |s|² omega.
    """
    quaternions = _unit_quaternions(motion)
    period = quaternions[: motion.recorded.samples_per_repeat]
    flips = motion.recorded.repeats > 1 and float(period[0] @ period[-1]) < 0
    s = motion.recorded.differentiated(quaternions, QUATERNION, antiperiodic=flips)
    size = np.sum(s.value**2, axis=1, keepdims=True)
    omega = 2 * _vector(s.value, s.first) / size
    norm_rate = np.sum(s.value * s.first, axis=1, keepdims=True) / size
    alpha = 2 * _vector(s.value, s.second) / size - 2 * norm_rate * omega
    rate_names, acceleration_names = (tuple(p + axis for axis in "xyz") for p in ("w", "al"))
    measured = motion.recorded.given(rate_names)
    if measured is not None:
        omega, alpha = measured, motion.recorded.differentiated(motion.recorded.stack(rate_names), rate_names).first
    given = motion.recorded.given(acceleration_names)
    signals = _named(QUATERNION, s.value / np.sqrt(size)) | _named(rate_names, omega)
    return signals | _named(acceleration_names, alpha if given is None else given)


def _vector(s: Array, ds: Array) -> Array:
    """Vector part of conj(s) ⊗ ds, Hamilton, (n, 3)."""
    v, w, dv, dw = s[:, :3], s[:, 3:], ds[:, :3], ds[:, 3:]
    product: Array = w * dv - dw * v - np.cross(v, dv)
    return product


def _translation(
    motion: Motion, position: Sequence[str], velocity: Sequence[str], acceleration: Sequence[str]
) -> dict[str, Array]:
    """Motion of the sensor origin from its recorded columns; without any its acceleration is zero."""
    zero = np.zeros((motion.recorded.samples, len(position)))
    rate, given = motion.recorded.given(velocity), motion.recorded.given(acceleration)
    signals: dict[str, Array] = {}
    derived = zero
    if all(name in motion.recorded.columns for name in position):
        moved = _rates(motion, motion.recorded.stack(position), position, velocity, acceleration)
        signals |= _named(position, moved.value)
        rate, derived = moved.first, moved.second
    elif rate is not None:
        derived = motion.recorded.differentiated(motion.recorded.stack(velocity), velocity).first
    if motion.recorded.at_rest:
        return signals | _named(velocity, zero) | _named(acceleration, zero)
    if rate is not None:
        signals |= _named(velocity, rate)
    return signals | _named(acceleration, derived if given is None else given)
