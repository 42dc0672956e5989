"""Symbolic measurement chain from motion to reading; each effect perturbs one of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.expressions.intermediate_variables import Definitions
from modeling.space import SensorMotion, Space, vector
from modeling.tool.rigid_body import RigidBody, newton_euler, rigid_body

if TYPE_CHECKING:
    from modeling.dynamics.deflection import Deflection
    from modeling.kinematics.perturbed_arm import PerturbedArm


class Stage(Enum):
    """Stage of the measurement chain on which an effect acts, in the order of the chain."""

    JOINTS = "joints"
    KINEMATICS = "kinematics"
    DEFLECTION = "tip flexibility"
    TIP_BODY = "tip body"
    MOUNTING = "mounting"
    GAIN = "gain"
    NONLINEARITY = "nonlinearity"
    PLAY = "play"
    LINEAR_DYNAMICS = "linear dynamics"
    ZERO = "zero"
    SATURATION = "saturation"

    @property
    def adds(self) -> bool:
        """Whether its effects change only load, transfer function and bias: no deflection, play or saturation."""
        return self not in (Stage.DEFLECTION, Stage.PLAY, Stage.SATURATION)


@dataclass(frozen=True)
class Chain:
    """Every stage of a wrench model as an expression.

    arm        the perturbed arm, if an effect acts on joints or links: the motion signals follow from joint signals
    deflection  of the tool on a spring, None if rigid; all tool quantities are then in tool axes
    gravity    in the world, m/s²
    body       the tool's moments about the sensor origin
    force, torque   of the environment on the tool, tool axes, about the sensor origin
    mounting   rotation from true sensor axes to the axes of the readings
    sign       +1 or -1 per channel: the convention of the readings (and a mirrored axis)
    gain       p x p, from the true wrench to the reading
    quadratic, cubic   p each: a reading r becomes r + quadratic r² + cubic r³
    play       half-widths (p) of the play operator between load and reading, None without
    memory     transfer function in s of all channels
    zero       bias and drift (p), added after the transfer function
    level      saturation levels (p), None without
    """

    space: Space
    gravity: sp.Matrix
    body: RigidBody
    sign: tuple[int, ...]
    gain: sp.Matrix
    zero: sp.Matrix
    quadratic: sp.Matrix
    cubic: sp.Matrix
    arm: PerturbedArm | None = None
    deflection: Deflection | None = None
    force: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    torque: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    mounting: sp.Matrix = field(default_factory=lambda: sp.eye(3))
    play: sp.Matrix | None = None
    memory: sp.Expr = field(default_factory=lambda: sp.S.One)
    level: sp.Matrix | None = None

    @property
    def motion(self) -> SensorMotion:
        """The tool's motion: the sensor's, with the deflection if there is one."""
        return self.space.motion if self.deflection is None else self.deflection.motion

    def definitions(self) -> Definitions:
        """Intermediate variables of the wrench: joints to sensor motion, sensor motion to deflected tool."""
        jointed = () if self.arm is None else self.arm.definitions(self.body, self.gravity)
        return jointed if self.deflection is None else (*jointed, *self.deflection.definitions)

    def wrench(self) -> tuple[sp.Matrix, sp.Matrix]:
        """Force and torque of the sensor on the tool, in sensor axes: Newton-Euler minus the environment's wrench."""
        motion = self.motion
        to_tool = motion.rotation.T
        lift = to_tool * (motion.acceleration - self.gravity)
        force, torque = newton_euler(self.body, lift, motion.omega, motion.alpha)
        force, torque = force - self.force, torque - self.torque
        return (force, torque) if self.deflection is None else self.deflection.to_sensor(force, torque)

    def load(self) -> sp.Matrix:
        """The reading before play, transfer function and bias: nonlinearity of gain · sign · mounting · wrench."""
        linear = self.reading(*self.wrench())
        terms = zip(linear, self.quadratic, self.cubic, strict=True)
        return sp.Matrix([r + a * r**2 + b * r**3 if a != 0 or b != 0 else r for r, a, b in terms])

    def equilibrium(self) -> sp.Matrix:
        """Residual of the deflection's equation of motion, in the deflection signals; empty for a rigid mounting."""
        return sp.zeros(0, 1) if self.deflection is None else self.deflection.equilibrium(self.wrench()[1])

    def reading(self, force: sp.Matrix, torque: sp.Matrix) -> sp.Matrix:
        """Linear reading of a wrench of the sensor on the tool (sensor frame): gain · sign · mounting · wrench."""
        wrench = sp.Matrix.vstack(self.mounting * force, self.mounting * torque)
        measured = sp.Matrix([wrench[row] for row in self.space.rows])
        return self.gain * sp.diag(*self.sign) * measured


def rigid_chain(
    space: Space,
    *,
    gravity: float,
    sign: tuple[int, ...],
    zero: sp.Matrix,
    mounting: sp.Matrix,
    arm: PerturbedArm | None = None,
) -> Chain:
    """The chain without effects: a rigid tool under gravity (m/s²), readings with the given signs."""
    channels = len(space.channels)
    return Chain(
        space=space,
        gravity=-sp.Float(gravity) * space.up,
        body=rigid_body(space),
        sign=sign,
        gain=sp.eye(channels),
        quadratic=sp.zeros(channels, 1),
        cubic=sp.zeros(channels, 1),
        zero=zero,
        arm=arm,
        mounting=mounting,
    )


def point_on_tip(chain: Chain, distance: sp.Expr) -> sp.Matrix:
    """The point at `distance` (m) along the tip from the sensor origin, in the sensor frame."""
    return distance * chain.space.tip_axis


def velocity_on_tip(chain: Chain, distance: sp.Expr) -> sp.Matrix:
    """Velocity (m/s) of that point in the world, expressed in the sensor frame: R' v + omega x r."""
    motion = chain.motion
    return motion.rotation.T * motion.velocity + motion.omega.cross(point_on_tip(chain, distance))


def world_vector(space: Space, *components: sp.Expr) -> sp.Matrix:
    """World vector, padded with zeros to three components."""
    return vector(*components, *([0] * (3 - len(components))))
