"""Errors of kinematics, tip body and mounting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from truewrench.simulated_rig.hidden_effect import HiddenEffect, SceneChange, TransientEffect
from truewrench.simulated_rig.mujoco_scene import Array, Scene, Track


@dataclass(frozen=True, kw_only=True)
class JointOffset(SceneChange):
    """Joint number `joint` (from 1) is at its recorded angle plus `offset` (rad)."""

    id = "joint_offset"
    planar_only = True
    joint: int = 2
    offset: float = 0.02

    def changed(self, scene: Scene) -> Scene:
        """Shift one joint."""
        offsets = scene.joint_offsets.copy()
        offsets[self.joint - 1] += self.offset
        return replace(scene, joint_offsets=offsets)


@dataclass(frozen=True, kw_only=True)
class LinkLengthError(SceneChange):
    """Link number `link` (from 1) is longer than in the rig's description by `error` (m)."""

    id = "link_length_error"
    planar_only = True
    link: int = 2
    error: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Lengthen one link."""
        lengths = list(scene.links)
        lengths[self.link - 1] += self.error
        return replace(scene, links=tuple(lengths))


@dataclass(frozen=True, kw_only=True)
class CentreOfMassOffset(SceneChange):
    """The planar tool's first moment has `mlx` (kg m) along x'; its inertia about the sensor stays."""

    id = "com_offset"
    planar_only = True
    mlx: float = 0.008

    def changed(self, scene: Scene) -> Scene:
        """Shift the first moment."""
        return replace(scene, first_moment=scene.first_moment + np.array([self.mlx, 0.0, 0.0]))


@dataclass(frozen=True, kw_only=True)
class GravityTilt(SceneChange):
    """Gravity is rotated about the world's x, then y (rad, right-handed).

    In the plane tilt_y is the angle, positive clockwise, and tilt_x has to be zero.
    """

    id = "gravity_tilt"
    tilt_x: float = 0.0
    tilt_y: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Rotate MuJoCo's gravity."""
        _require_planar(scene, self, tilt_x=self.tilt_x)
        turn = Rotation.from_euler("xyz", [self.tilt_x, self.tilt_y, 0.0])
        return replace(scene, gravity=np.asarray(turn.apply(scene.gravity)))


@dataclass(frozen=True, kw_only=True)
class SensorRotation(SceneChange):
    """The sensor is mounted rotated by Rz(yaw) Ry(pitch) Rx(roll) (rad) relative to the frame of the motion.

    In the plane yaw is the angle about e3, positive clockwise, and the others have to be zero. Its bias is
    not rotated.
    """

    id = "sensor_rotation"
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Rotate the sensor's site."""
        _require_planar(scene, self, roll=self.roll, pitch=self.pitch)
        turn = Rotation.from_euler("xyz", [self.roll, self.pitch, self.yaw])
        return replace(scene, sensor_turn=scene.sensor_turn * turn)


@dataclass(frozen=True, kw_only=True)
class PayloadChange(SceneChange, TransientEffect):
    """A point mass (kg) appears on the tool at (x, y, d) (m) at `time` (s; default: 40 % of the record)."""

    id = "payload_change"
    mass: float = 0.05
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0
    time: float | None = None

    def placed(self, track: Track) -> Self:
        """At 40 % of the record."""
        return self if self.time is not None else replace(self, time=track.instant(0.4))

    def changed(self, scene: Scene) -> Scene:
        """Attach the mass to the tool."""
        return replace(scene, payloads=(*scene.payloads, (self.mass, scene.point(self.x, self.y, self.d))))

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """From `time` on."""
        return np.asarray(time >= (np.inf if self.time is None else self.time))


def _require_planar(scene: Scene, effect: HiddenEffect, **angles: float) -> None:
    for name, angle in angles.items():
        if scene.planar and angle != 0:
            raise ValueError(f"{effect.id}: {name} = {angle} leaves the plane of a planar rig; set it to 0")
