"""Errors of kinematics, tip body and mounting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from truewrench.simulated_rig.commanded_motion import CommandedMotion, Spectrum
from truewrench.simulated_rig.hidden_effect import HiddenEffect, SceneChange, TransientEffect
from truewrench.simulated_rig.mujoco_scene import Array, Scene, States, Track, mujoco_frames

# Joint elasticity and backlash.


MAX_ITERATIONS = 100
"""Of the static equilibrium; each reduces the error by compliance times load per radian, some hundredths."""
CONVERGENCE_TOLERANCE = 1e-13
"""rad, rad/s, rad/s²: rounding of numbers of order 100."""


class JointDeflection(HiddenEffect):
    """An effect that moves joints away from their commanded position; `order` is its place between drive and link."""

    order: ClassVar[int]
    planar_only = True

    def moved(self, scene: Scene, drive: CommandedMotion, states: States) -> States:
        """Joint states for a commanded motion and the states before this effect."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class JointElasticity(JointDeflection):
    """Joint j deflects by compliance_j (rad/(N m)) times the torque of the tool's weight about it, when deflected.

    The static weight of the tool alone, payloads included, as if its tip were rigid; links are massless.
    """

    id = "joint_elasticity"
    order = 1
    compliance: tuple[float, ...] = (1e-3, 1.5e-3, 2e-3)

    def moved(self, scene: Scene, drive: CommandedMotion, states: States) -> States:
        """true = before + compliance · torque(true), iterated to convergence; rates likewise.

        Raises ValueError when the joints are too soft for the iteration to converge.
        """
        compliance = _per_joint(self, self.compliance, scene)
        true = states
        for _ in range(MAX_ITERATIONS):
            torques = weight_torques(scene, true)
            before, true = true, _sum(states, [compliance * torque for torque in torques])
            if max(np.abs(new - old).max() for new, old in zip(true, before, strict=True)) < CONVERGENCE_TOLERANCE:
                return true
        raise ValueError(f"{self.id}: no static equilibrium; make `compliance` smaller")


@dataclass(frozen=True, kw_only=True)
class JointBacklash(JointDeflection):
    """Joint j is at an end of its backlash: true = before ± width_j / 2 (rad), taken up by the load or by the motion.

    load    + where the tool's weight pulls the driven joint forward: tanh(torque / torque_scale), N m
    motion  the joint lags its drive: -tanh(dq / speed_scale), rad/s

    The transition is smooth. With `knocks` rates and accelerations are its exact derivatives: hundreds of rad/s² within
    a few milliseconds. Otherwise they are the drive's, without impact.
    """

    id = "joint_backlash"
    order = 0
    width: tuple[float, ...] = (0.01, 0.01, 0.01)
    taken_up: Literal["load", "motion"] = "load"
    torque_scale: float = 0.02
    speed_scale: float = 0.02
    knocks: bool = False

    def moved(self, scene: Scene, drive: CommandedMotion, states: States) -> States:
        """The side is decided at the recorded angles."""
        half = _per_joint(self, self.width, scene) / 2
        if self.taken_up == "motion":
            half, driven = -half, (drive.states[1], drive.states[2], drive.jerk)
            side = _side(*(values / self.speed_scale for values in driven))
        else:
            side = _side(*(values / self.torque_scale for values in weight_torques(scene, drive.states)))
        return _sum(states, [half * side[0], *(half * self.knocks * rate for rate in side[1:])])


def weight_torques(scene: Scene, states: States) -> States:
    """Torque (N, n) of the tool's weight about each joint, forward positive, N m, and its first two rates.

    sum over masses of e · ((c - p) x m g), with c the mass's and p the joint's position in MuJoCo, e = y the hinges'
    axis, and the same with their velocities and accelerations: gravity and the axis are constant.
    """
    offset = (states[0] + scene.joint_offsets, states[1], states[2])
    masses = [scene.mass, *(mass for mass, _ in scene.payloads)]
    matter = [("body", "tool"), *(("body", f"payload{i}") for i in range(len(scene.payloads)))]
    joints = [("xbody", f"link{j}") for j in range(len(scene.links))]
    frames = mujoco_frames(scene, joints + matter, offset)
    arms = frames[:, None, len(joints) :] - frames[:, : len(joints), None]
    torques = np.cross(arms, scene.gravity)[..., 1]
    total = np.einsum("njmo,m->ojn", torques, masses).transpose(0, 2, 1)
    return total[0], total[1], total[2]


def _side(x: Array, dx: Array, ddx: Array) -> States:
    """tanh x and its first two time derivatives."""
    side = np.tanh(x)
    slope = 1 - side**2
    return side, slope * dx, slope * (ddx - 2 * side * dx**2)


def _sum(states: States, shift: list[Array]) -> States:
    return states[0] + shift[0], states[1] + shift[1], states[2] + shift[2]


def _per_joint(effect: HiddenEffect, values: tuple[float, ...], scene: Scene) -> Array:
    if len(values) != len(scene.links):
        raise ValueError(f"{effect.id} needs one value for each of {len(scene.links)} joints; got {len(values)}")
    return np.array(values)


# Hidden effect of a flexible tip: the tool on a spring and a damper.


MIN_POINTS_PER_PERIOD = 2000
"""Minimum points per period for the tip's oscillation: its harmonics have decayed below half of that."""
DEFLECTION_TOLERANCE = 1e-12
"""rad: last step of the iteration for the periodic state, rounding of the torques over the stiffness."""


@dataclass(frozen=True, kw_only=True)
class TipFlexibility(HiddenEffect):
    """The tool turns at the sensor origin on a spring (N m/rad) with a damper (N m s/rad); the sensor does not.

    The torque of the sensor on the tool is -stiffness r - damping w, with r the rotation vector and w the angular rate
    of the tool relative to the sensor; in the plane both are along e3. It starts in its periodic steady state.
    """

    id = "tip_flexibility"
    stiffness: float = 50.0
    damping: float = 0.1

    def changed(self, scene: Scene) -> Scene:
        """A ball joint between the sensor and the tool."""
        return replace(scene, flexible=True, joint_offsets=np.append(scene.joint_offsets, np.zeros(4)))

    def settled(
        self, scene: Scene, drive: CommandedMotion, states: States, sensor_wrench: Callable[[States], Array]
    ) -> States:
        """The states of the flexible `scene`: those of the robot and the tip's (N, n + 4), (N, n + 3), (N, n + 3).

        `sensor_wrench` gives the sensor's wrench on the tool (N, 6) for such states. The periodic rotation vector r
        solves imbalance = torque + stiffness r + damping w = 0, by steps that are exact for a weightless tool on
        a sensor at rest: (stiffness + damping s + inertia s²) step = -imbalance.

        Raises ValueError when the iteration does not converge: the spring is too soft for the tool.
        """

        def compliance(s: Spectrum) -> Spectrum:
            s = s[:, None, None]
            return np.linalg.inv((self.stiffness + self.damping * s) * np.eye(3) + scene.inertia * s**2)

        deflection = np.zeros((len(states[0]), 3))
        for _ in range(MAX_ITERATIONS):
            torque = scene.sensor_turn.apply(sensor_wrench(_deflected_states(states, drive, deflection))[:, 3:])
            imbalance = torque + self.stiffness * deflection + self.damping * _spins(drive, deflection)[1]
            step = drive.filtered(imbalance, compliance)
            deflection = deflection - step
            if np.abs(step).max() < DEFLECTION_TOLERANCE:
                return _deflected_states(states, drive, deflection)
            if not np.abs(deflection).max() < np.pi:
                break
        raise ValueError(f"{self.id}: the spring is too soft for the tool; raise `stiffness`")


def _deflected_states(states: States, drive: CommandedMotion, deflection: Array) -> States:
    """States of the robot and of the tip: quaternion (w first), and rate and acceleration in the tool's axes."""
    q, dq, ddq = states
    quaternion = Rotation.from_rotvec(deflection).as_quat(scalar_first=True)
    spin = _spins(drive, deflection)[0]
    return np.hstack([q, quaternion]), np.hstack([dq, spin]), np.hstack([ddq, drive.rate(spin)])


def _spins(drive: CommandedMotion, deflection: Array) -> tuple[Array, Array]:
    """Angular rate of the tool relative to the sensor in the tool's and in the sensor's axes, rad/s.

    2 q* dq and 2 dq q* of the unit quaternion q = (w, v): 2 (w dv - dw v -+ v x dv).
    """
    quaternion = Rotation.from_rotvec(deflection).as_quat(scalar_first=True)
    rate = drive.rate(quaternion)
    along = quaternion[:, :1] * rate[:, 1:] - rate[:, :1] * quaternion[:, 1:]
    across = np.cross(quaternion[:, 1:], rate[:, 1:])
    return 2 * (along - across), 2 * (along + across)


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
