"""A hidden effect: the tool hangs on a spring and a damper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.simulated_rig.drive import Drive, Spectrum
from truewrench.simulated_rig.hidden import HiddenEffect
from truewrench.simulated_rig.scene import Array, Scene, States

FINEST = 2000
"""Points to a period at least, on which the tip swings: its harmonics have died out below half of that."""
SETTLED = 1e-12
"""rad: the last step of the search for the periodic state, a rounding of the torques over the stiffness."""
ROUNDS = 100
"""At most; a round leaves a share of the tool's static moment over the stiffness, a tenth, less at a resonance."""


@dataclass(frozen=True, kw_only=True)
class TipFlexibility(HiddenEffect):
    """The tool turns at the sensor origin on a spring (N m/rad) with a damper (N m s/rad); the sensor does not.

    The torque of the sensor on the tool is -stiffness r - damping w, with r the rotation vector and w the angular rate
    of the tool against the sensor; in the plane both stay along e3. It is in its periodic state from the beginning.
    """

    id = "tip_flexibility"
    stiffness: float = 50.0
    damping: float = 0.1

    def changed(self, scene: Scene) -> Scene:
        """A ball joint between the sensor and the tool."""
        return replace(scene, flexible=True, joint_offsets=np.append(scene.joint_offsets, np.zeros(4)))

    def settled(self, scene: Scene, drive: Drive, states: States, felt: Callable[[States], Array]) -> States:
        """The states of the flexible `scene`: those of the robot and the tip's (N, n + 4), (N, n + 3), (N, n + 3).

        `felt` says what the sensor's wrench on the tool is (N, 6) for such states. Sought is the periodic rotation
        vector r with imbalance = torque felt + stiffness r + damping w = 0, in steps that would be right for a tool
        without weight on a sensor that stands still: (stiffness + damping s + inertia s²) step = -imbalance.

        Raises ValueError when it is not found: the spring does not hold the tool.
        """

        def compliance(s: Spectrum) -> Spectrum:
            s = s[:, None, None]
            return np.linalg.inv((self.stiffness + self.damping * s) * np.eye(3) + scene.inertia * s**2)

        bend = np.zeros((len(states[0]), 3))
        for _ in range(ROUNDS):
            torque = scene.sensor_turn.apply(felt(_bent(states, drive, bend))[:, 3:])
            imbalance = torque + self.stiffness * bend + self.damping * _spins(drive, bend)[1]
            step = drive.filtered(imbalance, compliance)
            bend = bend - step
            if np.abs(step).max() < SETTLED:
                return _bent(states, drive, bend)
            if not np.abs(bend).max() < np.pi:
                break
        raise ValueError(f"{self.id}: the spring does not hold the tool; raise `stiffness`")


def _bent(states: States, drive: Drive, bend: Array) -> States:
    """The robot's states with the tip's: quaternion (w first), and rate and acceleration in the tool's axes."""
    q, dq, ddq = states
    quaternion = Rotation.from_rotvec(bend).as_quat(scalar_first=True)
    spin = _spins(drive, bend)[0]
    return np.hstack([q, quaternion]), np.hstack([dq, spin]), np.hstack([ddq, drive.rate(spin)])


def _spins(drive: Drive, bend: Array) -> tuple[Array, Array]:
    """Angular rate of the tool against the sensor in the tool's and in the sensor's axes, rad/s.

    2 q* dq and 2 dq q* of the unit quaternion q = (w, v): 2 (w dv - dw v -+ v x dv).
    """
    quaternion = Rotation.from_rotvec(bend).as_quat(scalar_first=True)
    rate = drive.rate(quaternion)
    along = quaternion[:, :1] * rate[:, 1:] - rate[:, :1] * quaternion[:, 1:]
    across = np.cross(quaternion[:, 1:], rate[:, 1:])
    return 2 * (along - across), 2 * (along + across)
