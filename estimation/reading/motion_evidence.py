"""Motion evidence: units and axes of a recording's motion and wrench as read, against what is often mistaken for them.

Each reading of the columns gives another specific force in the sensor, to which the weight of a tool is fitted
(`estimation/evidence/weight_fit.py`). Poses in space have `frame_evidence.py`; here are joint angles, with the arm's
kinematics, and planar poses, whose mounting the rig's convention states.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import pi

import numpy as np

from estimation.gravity.gravity_direction import gravity_evidence
from estimation.gravity.gravity_estimate import upright_direction
from estimation.reading.frame_evidence import (
    FEWEST,
    GRAVITY,
    LARGEST_ACCELERATION,
    LONGEST,
    STEP,
    FrameEvidence,
    FrameReading,
    frame_evidence,
)
from estimation.reading.log_reader import Array
from estimation.recordings.differentiation import Derivatives
from estimation.recordings.motion import MotionForm
from estimation.recordings.reading import FASTEST_QUANTILE
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import largest_deviation
from estimation.recordings.sign_convention import to_sensor_frame
from estimation.recordings.weight_fit import weight_fit
from modeling.kinematics.placement import Direction
from modeling.rig import Convention, Rig

DEGREE = pi / 180
POSITION = ("px", "py", "pz")
FASTEST = 15.0
"""rad/s: joints of collaborative arms turn at 2 pi at most, and angles in degrees look 57 times as fast."""
SPEED_TIME = 0.05
"""Seconds over which a speed is taken, so that the resolution of the angles is none."""


def motion_evidence(recording: Recording) -> FrameEvidence | None:
    """The evidence in a recording; None where the motion says nothing of where gravity is."""
    thin = thinned(recording)
    if thin.form is MotionForm.POSE:
        channels = dict(zip(thin.channels, thin.wrench.T, strict=True))
        time = {} if thin.time is None else {"time": thin.time}
        direction = None if thin.rig is None else thin.rig.gravity_direction
        position = thin.motion.recorded.derivatives.get(POSITION)
        return frame_evidence(
            {**thin.columns, **channels, **time}, direction, None if position is None else position.second
        )
    if thin.form is MotionForm.JOINTS and thin.arm is None:
        return None
    as_read, *others = _readings(thin)
    return FrameEvidence(as_read=as_read, best=min(others, key=lambda reading: reading.rms), others=len(others))


def thinned(recording: Recording) -> Recording:
    """The first run of a recording, with no more rows than the tool's weight needs; its motion as in all repeats."""
    stride = 1 if recording.dt is None else max(int(STEP / recording.dt), 1)
    rows = slice(0, min(recording.samples_per_repeat, LONGEST), stride)
    if recording.samples_per_repeat // stride < FEWEST:
        rows = slice(0, recording.samples_per_repeat)
    columns = {name: column[rows] for name, column in recording.columns.items()}
    time = None if recording.time is None else recording.time[rows]
    derivatives: dict[tuple[str, ...], Derivatives] = {}
    if recording.form is not MotionForm.PLANAR_POSE and recording.continuous and _repeats_alike(recording):
        # The Fourier series of the period is at hand, and quicker than a smoothing spline of its own.
        _ = recording.signals
        derivatives = {key: derived.rows(rows) for key, derived in recording.motion.recorded.derivatives.items()}
    run = recording.moved(columns=columns, time=time, repeats=1, continuous=True, derivatives=derivatives)
    return replace(run, wrench=recording.wrench[rows])


def _repeats_alike(recording: Recording) -> bool:
    """Whether there are repeats, of one motion."""
    if recording.repeats == 1 or recording.dt is None:
        return False
    worst = largest_deviation(recording.columns, recording.repeats)
    return worst is None or not worst.gross


def impossible_speed(angles: Mapping[str, Array], dt: float) -> tuple[str, float] | None:
    """The fastest of angles (n,) sampled every dt s, and its speed in rad/s, where no arm is as fast; else None."""
    lag = max(round(SPEED_TIME / dt), 1)
    speeds = {
        name: float(np.quantile(np.abs(column[lag:] - column[:-lag]), FASTEST_QUANTILE)) / lag / dt
        for name, column in angles.items()
        if len(column) > 2 * lag
    }
    name = max(speeds, key=lambda name: speeds[name], default=None)
    return None if name is None or speeds[name] < FASTEST else (name, speeds[name])


def angle_names(recording: Recording) -> list[str]:
    """Columns of the motion that are angles: phi, or the joints that turn."""
    if recording.form is MotionForm.PLANAR_POSE:
        return ["phi"]
    arm = recording.arm
    return [] if arm is None else [f"q{i}" for i, unit in enumerate(arm.units, 1) if unit == "rad"]


def _readings(recording: Recording) -> Iterator[FrameReading]:
    """The recording as read, then the other readings of it."""
    yield _reading("as read", "", recording)
    degrees = _with_columns(recording, dict.fromkeys(_derived(recording), DEGREE))
    yield _reading("the angles are in degrees", 'state units = { angle = "deg" } in a map', degrees)
    base = 'state wrench_axes = "base" in a map' if recording.dimension == 3 else "turn it into the sensor's axes"
    yield _reading("the wrench is along base axes", base, recording, in_base=True)
    if recording.dimension == 2:
        yield _reading(
            "the readings have the other sign", "state the other convention in the rig", recording, sign=-1.0
        )
    if recording.rig is None or recording.rig.gravity_direction is None:
        yield from _free_direction(recording)
    if recording.form is MotionForm.PLANAR_POSE:
        other = _with_columns(recording, {"phi": -1.0, "dphi": -1.0, "ddphi": -1.0})
        yield _reading("phi is the base's in the sensor", 'state orientation_of = "base" in a map', other)
        translation = np.stack([recording.signals[name] for name in ("ax", "ay")]) / GRAVITY
        if np.sqrt(np.mean(translation**2)) > LARGEST_ACCELERATION:
            metres = _with_columns(recording, dict.fromkeys(("px", "py", "vx", "vy", "ax", "ay"), 1e-3))
            yield _reading("the positions are in millimetres", 'state units = { position = "mm" } in a map', metres)


def _free_direction(recording: Recording) -> Iterator[FrameReading]:
    """The reading with gravity along another direction of the base, where the data show it."""
    rig = recording.rig or Rig()
    sign = rig.sensor.convention or (Convention.ON_TOOL if recording.dimension == 2 else Convention.AUTO)
    direction = gravity_evidence([recording], gravity=rig.gravity, convention=sign, mirror_y=rig.sensor.mirror_y)
    if direction is not None:
        yield _reading(direction.meaning, direction.advice, recording, down=direction.direction)


def _derived(recording: Recording) -> list[str]:
    """The angles and their rates."""
    return [prefix + name for name in angle_names(recording) for prefix in ("", "d", "dd")]


def _with_columns(recording: Recording, factors: Mapping[str, float]) -> Recording:
    """The recording with columns times factors, and with the derivatives known of them; phi is unwrapped before."""
    columns = {name: column * factors.get(name, 1.0) for name, column in recording.columns.items()}
    rescaled = {}
    for key, derived in recording.motion.recorded.derivatives.items():
        if "phi" not in key:
            scale = np.array([factors.get(name, 1.0) for name in key])
            value, first, second = (series * scale for series in (derived.value, derived.first, derived.second))
            rescaled[key] = replace(derived, value=value, first=first, second=second, spline=None)
    return recording.moved(columns=columns, derivatives=rescaled)


def _reading(
    meaning: str,
    advice: str,
    recording: Recording,
    *,
    in_base: bool = False,
    sign: float = 1.0,
    down: Direction | None = None,
) -> FrameReading:
    turns = _turns(recording)  # (n, k, k), from the sensor to the world
    direction = np.einsum("nji,nj->ni", turns, _specific_force(recording, down))
    force = recording.wrench[:, : recording.dimension]
    mounting = sign * _planar_mounting(recording) if recording.dimension == 2 else None
    if in_base:
        # In the world's own axes there is no mounting: what is measured is turned back.
        force, mounting = np.einsum("nji,nj->ni", turns, force), None if mounting is None else np.abs(mounting)
    return FrameReading(meaning=meaning, advice=advice, fit=weight_fit(direction, force, mounting=mounting))


def _turns(recording: Recording) -> Array:
    """Rotations (n, k, k) from axes of the sensor's body to the world's."""
    signals = recording.signals
    if recording.dimension == 3:
        quaternions = np.stack([signals[n] for n in ("qx", "qy", "qz", "qw")], axis=1)
        return to_sensor_frame(quaternions).swapaxes(1, 2)
    cosine, sine = np.cos(signals["phi"]), np.sin(signals["phi"])
    return np.stack([np.stack([cosine, sine], axis=1), np.stack([-sine, cosine], axis=1)], axis=1)


def _specific_force(recording: Recording, down: Direction | None) -> Array:
    """Acceleration minus gravity in the world (n, k), m/s²; along -z, or -y, unless `down` is stated."""
    names = ("apx", "apy", "apz") if recording.dimension == 3 else ("ax", "ay")
    acceleration = np.stack([recording.signals[name] for name in names], axis=1)
    return np.asarray(acceleration - GRAVITY * np.array(down or upright_direction(recording.dimension)))


def _planar_mounting(recording: Recording) -> Array:
    """The axes of a planar reading, x' and -y' of the tool, with the sign of the rig's convention."""
    sensor = None if recording.rig is None else recording.rig.sensor
    sign = -1.0 if sensor is not None and sensor.convention is Convention.ON_SENSOR else 1.0
    mirror = 1.0 if sensor is not None and sensor.mirror_y else -1.0
    return sign * np.diag([1.0, mirror])
