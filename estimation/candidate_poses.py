"""Static poses that a rig can take, as a model's signals and as commands to the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.recordings.motion import QUATERNION, MotionForm, numbered_names
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.kinematics.arm import Arm, PlanarArm
from modeling.kinematics.placement import base_angle, base_placement
from modeling.rig import Rig, Workspace

Array = NDArray[np.float64]

ANGLE_STEP = 5
"""Degrees between planar poses: a criterion in sin and cos of the angle is within cos 2.5° of its optimum."""
DISPLAY_UNITS = {"rad": (180 / np.pi, "°"), "m": (1000.0, " mm")}
"""Display unit of a joint: factor from SI, and symbol."""
POSTURE_SAMPLES = 512
"""Postures of an arm, evenly over the box of its limits (Sobol, a power of two): tip angles 1° apart."""


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """n static poses.

    columns   the commanded motion as recording columns: phi (rad), q1.. (rad) or qx, qy, qz, qw, each (n,)
    signals   all input signals of a model there, each (n,)
    words     description of each pose
    """

    columns: Mapping[str, Array]
    signals: Mapping[str, Array]
    words: tuple[str, ...]

    @classmethod
    def of(cls, recording: Recording) -> CandidatePoses:
        """Poses for the rig of a recording, in the form of its motion: tip angles every 5°, joint angles within the
        limits in whole degrees, or the 26 orientations with each sensor axis level or tilted, the tilted ones equally.

        Other signals (a position, a temperature) stay at their last value.
        Raises InputError when the tip is inside the workspace at none of the poses.
        """
        candidates = {MotionForm.PLANAR_POSE: _tip_angles, MotionForm.JOINTS: _postures, MotionForm.POSE: _orientations}
        columns, kinematic, words = candidates[recording.form](recording)
        count = len(words)
        others = {name: np.full(count, values[-1]) for name, values in recording.motion.model_signals.items()}
        return cls(columns, others | kinematic, words)

    def __len__(self) -> int:
        return len(self.words)


PosesAndDescriptions = tuple[dict[str, Array], dict[str, Array], tuple[str, ...]]


def _tip_angles(recording: Recording) -> PosesAndDescriptions:
    degrees = np.arange(-180 + ANGLE_STEP, 180 + ANGLE_STEP, ANGLE_STEP)
    signals, rig = {"phi": np.deg2rad(degrees)}, recording.rig or Rig()
    base = 0.0 if rig.gravity_direction is None else base_angle(rig.gravity_direction)
    return {"phi": signals["phi"] - base}, signals, tuple(f"phi = {angle}°" for angle in degrees)


def _postures(recording: Recording) -> PosesAndDescriptions:
    rig, arm = recording.rig or Rig(), recording.arm or PlanarArm(())
    limits = np.tile([-np.pi, np.pi], (arm.joints, 1))
    if rig.position_limits is not None:
        limits = np.where(np.isfinite(rig.position_limits), rig.position_limits, limits)
    factors = np.array([DISPLAY_UNITS[unit][0] for unit in arm.units])
    low, high = np.ceil(factors * limits[:, 0]), np.floor(factors * limits[:, 1])
    from scipy.stats import qmc  # a third of the time of a `fit`, which rarely advises postures

    cube = qmc.Sobol(arm.joints, scramble=False).random(POSTURE_SAMPLES)
    q = np.unique(np.round(low + cube * (high - low)), axis=0) / factors
    pose = arm.pose(q, np.zeros_like(q), np.zeros_like(q))
    inside = _inside(rig, arm, q)
    if not inside.any():
        raise InputError(
            what="the tip is outside the workspace at all candidate postures within the joint limits",
            where=rig.name or recording.name,
            remedy="correct [workspace] or [limits] in the rig",
        )
    names = numbered_names("q", arm.joints)
    columns = dict(zip(names, q[inside].T, strict=True))
    signs = [DISPLAY_UNITS[unit][1] for unit in arm.units]
    words = tuple(
        ", ".join(f"{n} = {count:.0f}{sign}" for n, count, sign in zip(names, row, signs, strict=True))
        for row in q[inside] * factors
    )
    return columns, columns | {name: values[inside] for name, values in pose.items()}, words


def _inside(rig: Rig, arm: Arm, q: Array) -> NDArray[np.bool_]:
    """Whether the tip is inside the workspace."""
    inside, tip = np.ones(len(q), dtype=bool), np.array(arm.tip(rig.tip_length or 0.0)(q.T))
    workspace = Workspace() if rig.workspace is None else rig.workspace
    for axis, place in zip(arm.space.axes, tip, strict=True):
        span = getattr(workspace, axis)
        inside &= True if span is None else (place >= span[0]) & (place <= span[1])
    return inside


def _orientations(recording: Recording) -> PosesAndDescriptions:
    """The vertical in the sensor frame along the 26 directions to a cube's faces, edges and corners."""
    upward = np.array([d for d in product((1, 0, -1), repeat=3) if any(d)], dtype=float)
    quaternions = np.stack([_rotation_to_vertical(d).as_quat() for d in upward])
    signals, rig = dict(zip(QUATERNION, quaternions.T, strict=True)), recording.rig or Rig()
    if rig.gravity_direction is None:
        return signals, signals, tuple(axes_in_words(d) for d in upward)
    base = Rotation.from_quat(base_placement(rig.gravity_direction).quaternion)
    commanded = (base.inv() * Rotation.from_quat(quaternions)).as_quat()
    return dict(zip(QUATERNION, commanded.T, strict=True)), signals, tuple(axes_in_words(d) for d in upward)


def _rotation_to_vertical(direction: Array) -> Rotation:
    """The rotation of least angle that takes a direction in the sensor frame to the world's z."""
    x, y, z = direction / np.linalg.norm(direction)
    axis, sine = np.array([y, -x, 0.0]), np.hypot(x, y)
    axis = axis / sine if sine else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * np.arctan2(sine, z))


def axes_in_words(upward: Array) -> str:
    """Where the sensor's axes point when `upward` (3,), entries 1, 0 and -1, is up: `x 45° up, y 45° down, z level`."""
    tilt = round(float(np.rad2deg(np.arcsin(1 / np.linalg.norm(upward)))))
    angle = "" if tilt == 90 else f"{tilt}° "
    names = {way: [axis for axis, d in zip("xyz", upward, strict=True) if d == way] for way in (1, -1, 0)}
    ways = {1: f"{angle}up", -1: f"{angle}down", 0: "level"}
    return ", ".join(f"{' and '.join(axes)} {ways[way]}" for way, axes in names.items() if axes)
