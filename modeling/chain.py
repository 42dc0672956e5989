"""The chain from a motion to a reading, stage by stage, symbolic; effects perturb one of its stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import sympy as sp

from modeling.space import Motion, Space, vector
from modeling.tip import Body, newton_euler, rigid_body

LAPLACE = sp.Symbol("s")


class Stage(Enum):
    """Where in the chain an effect acts; a reading passes the stages in this order."""

    JOINTS = "joints"
    KINEMATICS = "kinematics"
    TIP_BODY = "tip body"
    MOUNTING = "mounting"
    GAIN = "gain"
    MEMORY = "memory"
    ZERO = "zero"


@dataclass(frozen=True)
class Chain:
    """Every stage of a wrench model as an expression.

    pose       what the pose signals are in terms of joint signals, where an effect acts on the joints
    gravity    in the world, m/s²
    body       the tool's moments about the sensor origin
    force, torque   what the environment does to the tool, sensor frame, about the sensor origin
    mounting   rotation that takes true sensor axes to the axes that the readings are given in
    sign       +1 or -1 per channel: the convention of the readings (and a mirrored axis)
    gain       p x p, from the true wrench to the reading
    memory     transfer function in s of all channels
    zero       p, what is added last: bias and its drift
    """

    space: Space
    gravity: sp.Matrix
    body: Body
    sign: tuple[int, ...]
    gain: sp.Matrix
    zero: sp.Matrix
    force: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    torque: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    mounting: sp.Matrix = field(default_factory=lambda: sp.eye(3))
    memory: sp.Expr = sp.S.One
    pose: Mapping[sp.Symbol, sp.Expr] = field(default_factory=dict)

    @property
    def motion(self) -> Motion:
        """The sensor's motion, before `pose` is put in."""
        return self.space.motion

    def load(self) -> sp.Matrix:
        """The reading before memory and zero: gain · sign · mounting · (Newton-Euler - environment)."""
        motion = self.motion
        to_sensor = motion.rotation.T
        lift = to_sensor * (motion.acceleration - self.gravity)
        force, torque = newton_euler(self.body, lift, motion.omega, motion.alpha)
        reading = self.reading(force - self.force, torque - self.torque)
        return reading.xreplace(dict(self.pose)) if self.pose else reading

    def reading(self, force: sp.Matrix, torque: sp.Matrix) -> sp.Matrix:
        """What the channels make of a wrench of the sensor on the tool (sensor frame): gain · sign · mounting · it."""
        wrench = sp.Matrix.vstack(self.mounting * force, self.mounting * torque)
        measured = sp.Matrix([wrench[row] for row in self.space.rows])
        return self.gain * sp.diag(*self.sign) * measured


def rigid_chain(space: Space, *, gravity: float, sign: tuple[int, ...], zero: sp.Matrix, mounting: sp.Matrix) -> Chain:
    """The chain with no effect: a rigid tool under gravity (m/s²), readings with the signs given."""
    return Chain(
        space=space,
        gravity=-sp.Float(gravity) * space.up,
        body=rigid_body(space),
        sign=sign,
        gain=sp.eye(len(space.channels)),
        zero=zero,
        mounting=mounting,
    )


def point_on_tip(chain: Chain, distance: sp.Expr) -> sp.Matrix:
    """The point at `distance` (m) along the tip from the sensor origin, in the sensor frame."""
    return distance * chain.space.tip_axis


def velocity_on_tip(chain: Chain, distance: sp.Expr) -> sp.Matrix:
    """Velocity (m/s) of that point over the ground, in the sensor frame: R' v + omega x r."""
    motion = chain.motion
    return motion.rotation.T * motion.velocity + motion.omega.cross(point_on_tip(chain, distance))


def in_plane(space: Space, *components: sp.Expr) -> sp.Matrix:
    """World components filled up to three."""
    return vector(*components, *([0] * (3 - len(components))))
