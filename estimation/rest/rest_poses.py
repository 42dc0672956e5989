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
from modeling.rig import Rig

Array = NDArray[np.float64]

STEP = 5
"""Degrees between planar poses: a criterion that turns with sin and cos is within cos 2.5° of its best."""
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
    rig = recording.rig if recording.rig is not None else Rig()
    limits = np.tile([-np.pi, np.pi], (recording.joints, 1)) if rig.limits is None else rig.limits.position
    low, high = np.ceil(np.rad2deg(limits[:, 0])), np.floor(np.rad2deg(limits[:, 1]))
    unit = qmc.Sobol(recording.joints, scramble=False).random(POSTURES)
    q = np.deg2rad(np.unique(np.round(low + unit * (high - low)), axis=0))
    pose = PlanarArm(rig.link_lengths or ()).pose(q, np.zeros_like(q), np.zeros_like(q))
    inside = _inside(rig, pose)
    if not inside.any():
        raise InputError(
            what="the tip is outside the workspace wherever the joints are within their limits",
            where=rig.name or recording.name,
            remedy="correct [workspace] or [limits] in the rig",
        )
    names = numbered("q", recording.joints)
    columns = dict(zip(names, q[inside].T, strict=True))
    words = tuple(
        ", ".join(f"{n} = {angle:.0f}°" for n, angle in zip(names, row, strict=True)) for row in np.rad2deg(q[inside])
    )
    return columns, columns | {name: values[inside] for name, values in pose.items()}, words


def _inside(rig: Rig, pose: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Whether the tip is inside the workspace."""
    length, kept = rig.tip_length or 0.0, np.ones(len(pose["phi"]), dtype=bool)
    tip = (pose["px"] + length * np.sin(pose["phi"]), pose["py"] + length * np.cos(pose["phi"]))
    spans = (None, None) if rig.workspace is None else (rig.workspace.x, rig.workspace.y)
    for place, span in zip(tip, spans, strict=True):
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
