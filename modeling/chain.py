"""The chain from a motion to a reading, stage by stage, symbolic; effects perturb one of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from modeling import symbolic as sp
from modeling.space import Motion, Space, vector
from modeling.steps import Definitions
from modeling.tip import Body, newton_euler, rigid_body

if TYPE_CHECKING:
    from modeling.actual_arm import ActualArm
    from modeling.bend import Bend


class Stage(Enum):
    """Where in the chain an effect acts; a reading passes the stages in this order."""

    JOINTS = "joints"
    KINEMATICS = "kinematics"
    BEND = "tip flexibility"
    TIP_BODY = "tip body"
    MOUNTING = "mounting"
    GAIN = "gain"
    NONLINEARITY = "nonlinearity"
    PLAY = "play"
    MEMORY = "memory"
    ZERO = "zero"
    SATURATION = "saturation"

    @property
    def adds(self) -> bool:
        """Whether its effects show in the terms of load, memory and zero alone: no bend, no play, no clipping."""
        return self not in (Stage.BEND, Stage.PLAY, Stage.SATURATION)


@dataclass(frozen=True)
class Chain:
    """Every stage of a wrench model as an expression.

    arm        the arm as it is, where an effect acts on joints or links: its joint signals say what the sensor's are
    bend       of the tool against the sensor, where it hangs on a spring; then all on the tool is in the tool's axes
    gravity    in the world, m/s²
    body       the tool's moments about the sensor origin
    force, torque   what the environment does to the tool, tool's axes, about the sensor origin
    mounting   rotation that takes true sensor axes to the axes that the readings are given in
    sign       +1 or -1 per channel: the convention of the readings (and a mirrored axis)
    gain       p x p, from the true wrench to the reading
    quadratic, cubic   p each: a reading r becomes r + quadratic r² + cubic r³
    play       half-widths (p) of the play between load and reading, None without
    memory     transfer function in s of all channels
    zero       p, what is added last: bias and its drift
    level      p, beyond which a reading is clipped, None without
    """

    space: Space
    gravity: sp.Matrix
    body: Body
    sign: tuple[int, ...]
    gain: sp.Matrix
    zero: sp.Matrix
    quadratic: sp.Matrix
    cubic: sp.Matrix
    arm: ActualArm | None = None
    bend: Bend | None = None
    force: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    torque: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    mounting: sp.Matrix = field(default_factory=lambda: sp.eye(3))
    play: sp.Matrix | None = None
    memory: sp.Expr = field(default_factory=lambda: sp.S.One)
    level: sp.Matrix | None = None

    @property
    def motion(self) -> Motion:
        """The tool's motion: the sensor's, and the bend's where there is one."""
        return self.space.motion if self.bend is None else self.bend.motion

    def definitions(self) -> Definitions:
        """Steps to what the wrench is written in: from joints to the sensor's signals, and on to the bent tool's."""
        jointed = () if self.arm is None else self.arm.definitions(self.body, self.gravity)
        return jointed if self.bend is None else (*jointed, *self.bend.definitions)

    def wrench(self) -> tuple[sp.Matrix, sp.Matrix]:
        """Force and torque of the sensor on the tool, in the sensor's axes: Newton-Euler less the environment."""
        motion = self.motion
        to_tool = motion.rotation.T
        lift = to_tool * (motion.acceleration - self.gravity)
        force, torque = newton_euler(self.body, lift, motion.omega, motion.alpha)
        force, torque = force - self.force, torque - self.torque
        return (force, torque) if self.bend is None else self.bend.to_sensor(force, torque)

    def load(self) -> sp.Matrix:
        """The reading before play, memory and zero: nonlinearity of gain · sign · mounting · wrench."""
        straight = self.reading(*self.wrench())
        curved = zip(straight, self.quadratic, self.cubic, strict=True)
        return sp.Matrix([r + a * r**2 + b * r**3 if a != 0 or b != 0 else r for r, a, b in curved])

    def equilibrium(self) -> sp.Matrix:
        """What is zero when the bend obeys its spring, in the bend's signals; empty without a bend."""
        return sp.zeros(0, 1) if self.bend is None else self.bend.equilibrium(self.wrench()[1])

    def reading(self, force: sp.Matrix, torque: sp.Matrix) -> sp.Matrix:
        """What linear channels make of a wrench of the sensor on the tool (its frame): gain · sign · mounting · it."""
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
    arm: ActualArm | None = None,
) -> Chain:
    """The chain with no effect: a rigid tool under gravity (m/s²), readings with the signs given."""
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


def laplace() -> sp.Symbol:
    """The s of transfer functions, 1/s."""
    return sp.Symbol("s")


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
