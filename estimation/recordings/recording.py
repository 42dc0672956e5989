"""Recording: measured wrench and motion, and the motion signals that are inputs of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any

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
from modeling.errors import InputError
from modeling.kinematics.placement import motion_in_world
from modeling.rig import PLANAR_CHANNELS, Rig
from modeling.table import Column, Table, Tabular, Value

if TYPE_CHECKING:
    import pandas as pd

    from estimation.recordings.reading_report import ReadingReport
    from modeling.kinematics.arm import Arm


Array = NDArray[np.float64]

QUATERNION = ("qx", "qy", "qz", "qw")


class MotionForm(Enum):
    """Form in which the motion was recorded; the value lists the columns that make it complete."""

    JOINTS = "q1..qn"
    PLANAR_POSE = "phi"
    POSE = "qx, qy, qz, qw"


@dataclass(frozen=True, eq=False)
class WholeLog:
    """All rows of a log of which a recording has whole repeats: `recording`, one run, and the rows first <= i < last of
    the repeats in it."""

    recording: Recording
    first: int
    last: int

    @property
    def left_out(self) -> tuple[tuple[int, int], ...]:
        """Rows that are none of the repeats, as first <= i < last."""
        ends = ((0, self.first), (self.last, self.recording.samples))
        return tuple((begin, end) for begin, end in ends if end > begin)

    @property
    def share(self) -> float:
        """Share of the rows that the repeats are."""
        return (self.last - self.first) / self.recording.samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording(Tabular):
    """Samples of a wrench and of the motion, as recorded; `read` gives it.

    Parameters
    ----------
    name : str
        Name of the file, for messages and recording-specific parameters (`bias_fx@name`).
    channels : tuple of str
        fx, fy, tau in the plane; fx, fy, fz, tx, ty, tz in six axes.
    wrench : array (n, p)
        Readings in N and N m, in the order of the channels, with the sensor's signs.
    columns : mapping of str to array (n,)
        Everything else that was recorded, SI, as read.
    form : MotionForm
        How the motion was recorded: joint angles, planar pose or pose.
    time : array (n,) or None
        Uniform, in s, from 0 on (in every repeat when they are separate runs, `continuous` False); None when every row
        is a static pose.
    repeats : int, optional
        How often the motion was run, with n / repeats samples each; by default 1.
    continuous : bool, optional
        Whether the repeats follow each other without a pause, by default True.
    rig : Rig, optional
        The rig with its kinematics; by default none.
    reading : ReadingReport, optional
        How a log became this recording; by default none, as for a file with the columns of a recording.
    whole : WholeLog, optional
        The log with the rows outside the repeats that were cut; by default none, as where all rows are used.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"))
    >>> recording.samples, recording.repeats, round(recording.dt, 6)
    (4000, 8, 0.01)
    >>> sorted(recording.signals)[:4], recording.signals["ddphi"].shape
    (['ax', 'ay', 'ddphi', 'ddq1'], (4000,))
    """

    name: str
    channels: tuple[str, ...]
    wrench: Array
    columns: Mapping[str, Array]
    form: MotionForm
    time: Array | None
    repeats: int = 1
    continuous: bool = True
    rig: Rig | None = None
    reading: ReadingReport | None = None
    whole: WholeLog | None = None

    def __repr__(self) -> str:
        length = "poses at rest" if self.dt is None else f"samples at {1 / self.dt:.6g} Hz"
        runs = f"{self.repeats} x " if self.repeats > 1 else ""
        used = motion_columns(self.form, self.joints)
        known = "motion " + " ".join(name for name in used if name in self.columns)
        if self.auxiliary:
            known += f"; auxiliary signals {' '.join(self.auxiliary)}"
        return f"Recording {self.name!r}: {runs}{self.samples_per_repeat} {length}, {' '.join(self.channels)}; {known}"

    def __str__(self) -> str:
        return repr(self)

    @property
    def table(self) -> Table:
        """Smallest value, mean, largest value and std of each channel and column, SI."""
        numbers = (Column(name, format=".4g") for name in ("smallest", "mean", "largest", "std"))
        series = dict(zip(self.channels, self.wrench.T, strict=True)) | dict(self.columns)
        rows: list[tuple[Value, ...]] = [
            (name, *(float(f(y)) for f in (np.min, np.mean, np.max, np.std))) for name, y in series.items()
        ]
        return Table.of(("column", *numbers), rows)

    def printed(self) -> list[Table | str]:
        """What it is, then its columns."""
        return [repr(self), self.table]

    def to_frame(self) -> pd.DataFrame:
        """Time, repeat, wrench and every other column as a data frame, which `from_dataframe` takes."""
        import pandas as pd

        found = {} if self.time is None else {"time": np.arange(self.samples) * (self.dt or 1.0)}
        if self.repeats > 1:
            found["repeat"] = np.repeat(np.arange(self.repeats), self.samples_per_repeat)
        return pd.DataFrame(found | dict(zip(self.channels, self.wrench.T, strict=True)) | dict(self.columns))

    def to_data(self) -> dict[str, Any]:
        """Name and columns as plain data; `from_dataframe` takes a data frame of the columns."""
        columns = {name: column.tolist() for name, column in self.to_frame().items()}
        return {"name": self.name, "continuous": self.continuous, "columns": columns}

    @property
    def samples(self) -> int:
        """The number of rows n."""
        return len(self.wrench)

    @property
    def samples_per_repeat(self) -> int:
        """Rows in one repeat, n when there is only one."""
        return self.samples // self.repeats

    @property
    def at_rest(self) -> bool:
        """Whether every row is a static pose."""
        return self.time is None

    @property
    def dt(self) -> float | None:
        """Sampling interval in s; None for static poses."""
        return None if self.time is None else float(self.time[1] - self.time[0])

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in six axes."""
        return 2 if self.channels == PLANAR_CHANNELS else 3

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
        return tuple(name for name in self.columns if name not in used)

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
        found = {name: self.columns[name] for name in self.auxiliary}
        found |= {"order": np.arange(self.samples, dtype=float)}
        if self.time is not None:
            found["time"] = self.time
        return self._in_world(found | derive[self.form](self))

    @cached_property
    def world_columns(self) -> Mapping[str, Array]:
        """The columns with pose and motion in the world, as recorded where the base stands upright."""
        return self._in_world(self.columns)

    def _in_world(self, motion: Mapping[str, Array]) -> Mapping[str, Array]:
        """Motion from base axes to the world; that of joints is in the world, by the arm."""
        direction = None if self.rig is None or self.form is MotionForm.JOINTS else self.rig.gravity_direction
        return motion if direction is None else motion_in_world(motion, direction)

    @cached_property
    def own_motion(self) -> OwnMotion | None:
        """The recording with each repeat's own motion as signals; None where the repeats are equal within noise."""
        if self.repeats == 1 or self.dt is None or isinstance(self, OwnMotion):
            return None
        series = measured_motion(self)
        if not differing_columns(series, self.repeats, continuous=self.continuous).any():
            return None
        return OwnMotion(**{f.name: getattr(self, f.name) for f in fields(self)})

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
            found = self._differentiated(series, held_with or names, antiperiodic)
            if not key:
                return found
            self.derivatives[key] = found
        return self.derivatives[key]

    @cached_property
    def derivatives(self) -> dict[tuple[str, ...], Derivatives]:
        """What was derived so far, by the columns that it comes from."""
        return {}

    def drawn_motions(self, rng: np.random.Generator, count: int) -> Recording:
        """`count` runs with motions at random from what the samples leave open, one after another in one recording.

        Of the `derivatives` so far, those of `signals`; auxiliary columns are in every run as they were recorded, and
        columns are held where those of this recording are. The motion jumps between the runs, so that of several only
        what depends on single samples can be predicted.
        """
        assert self.time is not None  # static poses are not smoothed
        times, span = np.arange(self.samples) * np.float64(self.dt or 0.0), self.samples * (self.dt or 0.0)
        splines = {key: found.spline for key, found in self.derivatives.items() if found.spline is not None}
        innovations = [[spline.innovations(rng) for spline in splines.values()] for _ in range(count)]
        other = replace(
            self,
            wrench=np.tile(self.wrench, (count, 1)),
            columns={name: np.tile(column, count) for name, column in self.columns.items()},
            time=np.concatenate([self.time + i * span for i in range(count)]),
        )
        for (key, spline), own in zip(splines.items(), zip(*innovations, strict=True), strict=True):
            drawn = spline.drawn(*own)
            other.derivatives[key] = SplineTimes.of(spline, times).derivatives(drawn).one_after_another(count)
        other.held_columns.update(self.held_columns)
        return other

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
        if key not in self.held_columns:
            self.held_columns[key] = TrueSamples.of((self.columns[name] for name in names), self.dt, self.samples)
        return self.held_columns[key]

    @cached_property
    def held_columns(self) -> dict[tuple[str, ...], TrueSamples | None]:
        """What `true_samples` has found so far, by the columns' names."""
        return {}

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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OwnMotion(Recording):
    """A recording whose signals are the motion of each repeat: the mean motion and what the repeat adds to it."""

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


def _unit_quaternions(recording: Recording) -> Array:
    """The recorded orientation (n, 4), x y z w, normalised, without jumps between q and -q."""
    recorded = recording.stack(QUATERNION).reshape(recording.repeats, -1, 4)
    unit = np.stack([_without_sign_flips(run) for run in recorded])
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    facing = np.sum(unit * unit[:1], axis=(1, 2), keepdims=True)
    aligned: Array = (unit * np.where(facing < 0, -1.0, 1.0)).reshape(-1, 4)
    return aligned


def _without_sign_flips(quaternions: Array) -> Array:
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 0, 1.0, -1.0)
    return quaternions * signs[:, None]


def measured_motion(recording: Recording) -> Array:
    """Every recorded column of the motion (n, k), angles and quaternions without jumps."""
    used = [name for name in motion_columns(recording.form, recording.joints) if name in recording.columns]
    parts = [_ramp_and_periodic_angle(recording)[1]] if "phi" in used else []
    parts += [_unit_quaternions(recording)] if "qw" in used else []
    others = [name for name in used if name not in ("phi", *QUATERNION)]
    return np.concatenate([*parts, *([recording.stack(others)] if others else [])], axis=1)


# -------------------------------------------------------------------------------------------- signals


def _rates(
    recording: Recording,
    value: Array,
    names: Sequence[str],
    first: Sequence[str],
    second: Sequence[str],
    held_with: Sequence[str] = (),
) -> Derivatives:
    """The motion (n, k) of columns `names` with its rates: as recorded under `first` and `second`, else derived."""
    derived = recording.differentiated(value, names, held_with=held_with)
    rate, acceleration = recording.given(first), recording.given(second)
    if acceleration is None:
        of_rate = recording.differentiated(recording.stack(first), first) if rate is not None else None
        acceleration = derived.second if of_rate is None else of_rate.first
    rate = derived.first if rate is None else rate
    return replace(derived, first=rate, second=acceleration)


def _named(names: Sequence[str], series: Array) -> dict[str, Array]:
    return dict(zip(names, series.T, strict=True))


def _joint_motion(recording: Recording) -> dict[str, Array]:
    """Poses of the sensor from joint angles by the arm's kinematics (in the plane 22.2)."""
    names = [numbered_names(prefix, recording.joints) for prefix in ("q", "dq", "ddq")]
    # Each joint by itself: a log may hold the velocity of some joints only.
    rates = [
        _rates(recording, recording.stack([q]), [q], [dq], [ddq], names[0]) for q, dq, ddq in zip(*names, strict=True)
    ]
    q, dq, ddq = (
        np.concatenate([getattr(rate, part) for rate in rates], axis=1) for part in ("value", "first", "second")
    )
    pose = {} if recording.arm is None else recording.arm.pose(q, dq, ddq)
    joints = (_named(name, series) for name, series in zip(names, (q, dq, ddq), strict=True))
    return {key: value for part in joints for key, value in part.items()} | pose


def _planar_motion(recording: Recording) -> dict[str, Array]:
    ramp, phi = _ramp_and_periodic_angle(recording)
    angle = _rates(recording, phi, ["phi"], ["dphi"], ["ddphi"])
    found = {"phi": angle.value[:, 0] + ramp, "dphi": angle.first[:, 0], "ddphi": angle.second[:, 0]}
    if recording.dt is not None and "dphi" not in recording.columns:
        found["dphi"] = found["dphi"] + (ramp[1] - ramp[0]) / recording.dt
    return found | _translation(recording, ("px", "py"), ("vx", "vy"), ("ax", "ay"))


def _ramp_and_periodic_angle(recording: Recording) -> tuple[Array, Array]:
    """phi as a ramp of whole turns per period (n,) and its periodic part (n, 1), in rad."""
    phi = recording.columns["phi"].reshape(recording.repeats, -1)
    zero = np.zeros(recording.samples)
    if recording.at_rest:
        # Poses in any order: only whole turns between repeats of the same pose are removed.
        return zero, np.unwrap(phi, axis=0).reshape(-1, 1)
    phi = np.unwrap(phi, axis=1)
    phi = phi - 2 * np.pi * np.round((phi[:, :1] - phi[0, 0]) / (2 * np.pi))
    if recording.repeats == 1 or not recording.continuous:
        return zero, phi.reshape(-1, 1)
    turns = np.round((phi[0, -1] - phi[0, 0]) / (2 * np.pi))
    ramp = 2 * np.pi * turns * np.arange(phi.shape[1]) / phi.shape[1]
    return np.tile(ramp, recording.repeats), (phi - ramp).reshape(-1, 1)


def _spatial_motion(recording: Recording) -> dict[str, Array]:
    found = _rotation(recording)
    position, velocity, acceleration = (tuple(p + axis for axis in "xyz") for p in ("p", "vp", "ap"))
    return found | _translation(recording, position, velocity, acceleration)


def _rotation(recording: Recording) -> dict[str, Array]:
    """Orientation q, angular velocity and acceleration in the sensor frame.

    With s the smoothed components, q = s / |s|; conj(q) dq and conj(s) ds / |s|² differ by a scalar, so
    omega = 2 vec(conj(s) ds) / |s|², and since conj(ds) ds is a scalar too,
    alpha = 2 vec(conj(s) dds) / |s|² - 2 (s . ds) / |s|² omega.
    """
    quaternions = _unit_quaternions(recording)
    period = quaternions[: recording.samples_per_repeat]
    flips = recording.repeats > 1 and float(period[0] @ period[-1]) < 0
    s = recording.differentiated(quaternions, QUATERNION, antiperiodic=flips)
    size = np.sum(s.value**2, axis=1, keepdims=True)
    omega = 2 * _vector(s.value, s.first) / size
    norm_rate = np.sum(s.value * s.first, axis=1, keepdims=True) / size
    alpha = 2 * _vector(s.value, s.second) / size - 2 * norm_rate * omega
    rate_names, acceleration_names = (tuple(p + axis for axis in "xyz") for p in ("w", "al"))
    measured = recording.given(rate_names)
    if measured is not None:
        omega, alpha = measured, recording.differentiated(recording.stack(rate_names), rate_names).first
    given = recording.given(acceleration_names)
    found = _named(QUATERNION, s.value / np.sqrt(size)) | _named(rate_names, omega)
    return found | _named(acceleration_names, alpha if given is None else given)


def _vector(s: Array, ds: Array) -> Array:
    """Vector part of conj(s) ⊗ ds, Hamilton, (n, 3)."""
    v, w, dv, dw = s[:, :3], s[:, 3:], ds[:, :3], ds[:, 3:]
    product: Array = w * dv - dw * v - np.cross(v, dv)
    return product


def _translation(
    recording: Recording, position: Sequence[str], velocity: Sequence[str], acceleration: Sequence[str]
) -> dict[str, Array]:
    """Motion of the sensor origin from its recorded columns; without any its acceleration is zero."""
    zero = np.zeros((recording.samples, len(position)))
    rate, given = recording.given(velocity), recording.given(acceleration)
    found: dict[str, Array] = {}
    derived = zero
    if all(name in recording.columns for name in position):
        moved = _rates(recording, recording.stack(position), position, velocity, acceleration)
        found |= _named(position, moved.value)
        rate, derived = moved.first, moved.second
    elif rate is not None:
        derived = recording.differentiated(recording.stack(velocity), velocity).first
    if recording.at_rest:
        return found | _named(velocity, zero) | _named(acceleration, zero)
    if rate is not None:
        found |= _named(velocity, rate)
    return found | _named(acceleration, derived if given is None else given)


def with_readings(recording: Recording, wrench: NDArray[np.float64]) -> Recording:
    """The recording with its readings replaced by `wrench` (n, p); its signals are not derived again.

    There are no such readings outside the repeats of a log that was cut.
    """
    other = replace(recording, wrench=wrench, whole=None)
    # The caches of `signals` and `derivatives`: they depend on the motion alone, and cost more than a fit.
    vars(other).update(signals=recording.signals, derivatives=recording.derivatives, own_motion=recording.own_motion)
    return other


# SHA-256 of a recording's readings, by which a file knows the recordings that it was made of.


def readings_digest(recording: Recording) -> str:
    """SHA-256 of a recording's readings, by which a calibration or a model file recognises its own."""
    return sha256(np.ascontiguousarray(recording.wrench, dtype="<f8").tobytes()).hexdigest()


def require_different_readings(recordings: Sequence[Recording], where: str) -> None:
    """InputError for readings that were given twice: their agreement with themselves would count as evidence."""
    known: dict[str, str] = {}
    for recording in recordings:
        digest = readings_digest(recording)
        if digest in known:
            what = f"{recording.name} has the same readings as {known[digest]}: one recording given twice"
            raise InputError(what=what, where=where, remedy="give each recording once; validate with another motion")
        known[digest] = recording.name
