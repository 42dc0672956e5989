"""Joint elasticity and backlash."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from truewrench.simulated_rig.commanded_motion import CommandedMotion
from truewrench.simulated_rig.hidden_effect import HiddenEffect
from truewrench.simulated_rig.mujoco_scene import Array, Scene, States, mujoco_frames

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
        found = states
        for _ in range(MAX_ITERATIONS):
            torques = weight_torques(scene, found)
            before, found = found, _sum(states, [compliance * torque for torque in torques])
            if max(np.abs(new - old).max() for new, old in zip(found, before, strict=True)) < CONVERGENCE_TOLERANCE:
                return found
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
