"""Hidden effect of a flexible tip: the tool on a spring and a damper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.simulated_rig.commanded_motion import CommandedMotion, Spectrum
from truewrench.simulated_rig.hidden_effect import HiddenEffect
from truewrench.simulated_rig.mujoco_scene import Array, Scene, States

MIN_POINTS_PER_PERIOD = 2000
"""Minimum points per period for the tip's oscillation: its harmonics have decayed below half of that."""
CONVERGENCE_TOLERANCE = 1e-12
"""rad: last step of the iteration for the periodic state, rounding of the torques over the stiffness."""
MAX_ITERATIONS = 100
"""Each iteration reduces the error by the tool's static moment over the stiffness, a tenth, less at a resonance."""


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
            if np.abs(step).max() < CONVERGENCE_TOLERANCE:
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
