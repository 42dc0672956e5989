"""RestPoses: poses at rest that a rig could take, as a model's signals and as a person drives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from estimation.recording import QUATERNION, MotionForm, Recording, numbered
from estimation.response import signals_of
from modeling.arm import PlanarArm
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.rig import Rig, Workspace

Array = NDArray[np.float64]

STEP = 5
"""Degrees between planar poses: a criterion that turns with sin and cos is within cos 2.5° of its best."""
PARTS = {"rad": (180 / np.pi, "°"), "m": (1000.0, " mm")}
"""What a person sets a joint in: how many make its unit, and their sign."""
POSTURES = 512
"""Of a jointed arm, evenly over the box of its limits (Sobol, a power of two): angles of the tip 1° apart."""


@dataclass(frozen=True, eq=False)
class RestPoses:
    """n poses.

    columns   what to drive, as a recording holds it: phi (rad), q1.. (rad) or qx, qy, qz, qw, each (n,)
    signals   every signal that a model may take there, each (n,)
    words     each pose in words
    """

    columns: Mapping[str, Array]
    signals: Mapping[str, Array]
    words: tuple[str, ...]

    @classmethod
    def of(cls, recording: Recording) -> RestPoses:
        """Poses for the rig of a recording, in the form of its motion: tip angles every 5°, joint angles within the
        limits in whole degrees, or the 26 orientations with the sensor's axes level, or alike up or down.

        What else a model takes (a position, a temperature) stays at its last value.
        Raises InputError when the tip is inside the workspace at none of the poses.
        """
        make = {MotionForm.PLANAR_POSE: _tip_angles, MotionForm.JOINTS: _postures, MotionForm.POSE: _orientations}
        columns, posed, words = make[recording.form](recording)
        count = len(words)
        others = {name: np.full(count, values[-1]) for name, values in signals_of(recording).items()}
        return cls(columns, others | posed, words)

    def __len__(self) -> int:
        return len(self.words)


Made = tuple[dict[str, Array], dict[str, Array], tuple[str, ...]]


def _tip_angles(recording: Recording) -> Made:
    degrees = np.arange(-180 + STEP, 180 + STEP, STEP)
    columns = {"phi": np.deg2rad(degrees)}
    return columns, columns, tuple(f"phi = {angle}°" for angle in degrees)


def _postures(recording: Recording) -> Made:
    rig, arm = recording.rig or Rig(), recording.arm or PlanarArm(())
    limits = np.tile([-np.pi, np.pi], (arm.joints, 1))
    if rig.position_limits is not None:
        limits = np.where(np.isfinite(rig.position_limits), rig.position_limits, limits)
    parts = np.array([PARTS[unit][0] for unit in arm.units])
    low, high = np.ceil(parts * limits[:, 0]), np.floor(parts * limits[:, 1])
    cube = qmc.Sobol(arm.joints, scramble=False).random(POSTURES)
    q = np.unique(np.round(low + cube * (high - low)), axis=0) / parts
    pose = arm.pose(q, np.zeros_like(q), np.zeros_like(q))
    inside = _inside(rig, arm, q)
    if not inside.any():
        raise InputError(
            what="the tip is outside the workspace wherever the joints are within their limits",
            where=rig.name or recording.name,
            remedy="correct [workspace] or [limits] in the rig",
        )
    names = numbered("q", arm.joints)
    columns = dict(zip(names, q[inside].T, strict=True))
    signs = [PARTS[unit][1] for unit in arm.units]
    words = tuple(
        ", ".join(f"{n} = {count:.0f}{sign}" for n, count, sign in zip(names, row, signs, strict=True))
        for row in q[inside] * parts
    )
    return columns, columns | {name: values[inside] for name, values in pose.items()}, words


def _inside(rig: Rig, arm: Arm, q: Array) -> NDArray[np.bool_]:
    """Whether the tip is inside the workspace."""
    kept, tip = np.ones(len(q), dtype=bool), np.array(arm.tip(rig.tip_length or 0.0)(q.T))
    workspace = Workspace() if rig.workspace is None else rig.workspace
    for axis, place in zip(arm.space.axes, tip, strict=True):
        span = getattr(workspace, axis)
        kept &= True if span is None else (place >= span[0]) & (place <= span[1])
    return kept


def _orientations(recording: Recording) -> Made:
    """Up, seen from the sensor, along the axes, the edges' and the corners' diagonals of a cube."""
    upward = np.array([d for d in product((1, 0, -1), repeat=3) if any(d)], dtype=float)
    quaternions = np.stack([_turn_upward(d).as_quat() for d in upward])
    columns = dict(zip(QUATERNION, quaternions.T, strict=True))
    return columns, columns, tuple(in_words(d) for d in upward)


def _turn_upward(direction: Array) -> Rotation:
    """The shortest rotation that takes a direction of the sensor to the world's z."""
    x, y, z = direction / np.linalg.norm(direction)
    axis, sine = np.array([y, -x, 0.0]), np.hypot(x, y)
    axis = axis / sine if sine else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * np.arctan2(sine, z))


def in_words(upward: Array) -> str:
    """Where the sensor's axes point when `upward` (3,), entries 1, 0 and -1, is up: `x 45° up, y 45° down, z level`."""
    tilt = round(float(np.rad2deg(np.arcsin(1 / np.linalg.norm(upward)))))
    angle = "" if tilt == 90 else f"{tilt}° "
    names = {way: [axis for axis, d in zip("xyz", upward, strict=True) if d == way] for way in (1, -1, 0)}
    ways = {1: f"{angle}up", -1: f"{angle}down", 0: "level"}
    return ", ".join(f"{' and '.join(axes)} {ways[way]}" for way, axes in names.items() if axes)
