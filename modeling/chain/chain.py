"""Symbolic measurement chain from motion to reading; each effect perturbs one of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from typing import TYPE_CHECKING, TypeVar

from modeling import symbolic as sp
from modeling.chain.stages import Bias, ChainStage, Gain, LinearDynamics, Mounting, Stage, SymbolicMap
from modeling.compiled.straight_line_program import Definitions
from modeling.rigid_body import RigidBody, newton_euler, rigid_body
from modeling.space import SensorMotion, Space, vector

if TYPE_CHECKING:
    from modeling.dynamics.deflection import Deflection
    from modeling.kinematics.perturbed_arm import PerturbedArm


__all__ = ["Chain", "Stage", "point_on_tip", "rigid_chain", "velocity_of_point", "world_vector"]


@dataclass(frozen=True)
class Chain:
    """Every stage of a wrench model: the motion and wrench of the tool, then the stages of the sensor in order.

    arm        the perturbed arm, if an effect acts on joints or links: the motion signals follow from joint signals
    deflection  of the tool on a spring, None if rigid; all tool quantities are then in tool axes
    gravity    in the world, m/s²
    body       the tool's moments about the sensor origin
    force, torque   of the environment on the tool, tool axes, about the sensor origin
    stages     from the true wrench to the reading: mounting, gain, nonlinearity, play, linear dynamics, bias, clipping
    """

    space: Space
    gravity: sp.Matrix
    body: RigidBody
    stages: tuple[ChainStage, ...]
    arm: PerturbedArm | None = None
    deflection: Deflection | None = None
    force: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))
    torque: sp.Matrix = field(default_factory=lambda: sp.zeros(3, 1))

    # ------------------------------------------------------------------------------- stages of the sensor

    def __getitem__(self, kind: type[AnyStage]) -> AnyStage:
        """The stage of that class; KeyError without."""
        for stage in self.stages:
            if isinstance(stage, kind):
                return stage
        raise KeyError(kind.__name__)

    def with_stage(self, stage: ChainStage) -> Chain:
        """The chain with that stage at its place, instead of an earlier one of its class."""
        others = [other for other in self.stages if type(other) is not type(stage)]
        return replace(self, stages=tuple(sorted([*others, stage], key=lambda s: s.place.number)))

    @property
    def maps(self) -> tuple[SymbolicMap, ...]:
        """The stages up to the nonlinearity, from the true wrench to the load: symbolic maps."""
        return tuple(s for s in self.stages if isinstance(s, SymbolicMap) and not _dynamic(s))

    @property
    def dynamics(self) -> tuple[ChainStage, ...]:
        """The stages after the nonlinearity, from load to reading."""
        return tuple(s for s in self.stages if _dynamic(s))

    @property
    def bias(self) -> sp.Matrix:
        """Bias and drift (p, 1)."""
        return self[Bias].value

    @property
    def transfer_function(self) -> sp.Expr:
        """Transfer function in s of all channels, 1 without."""
        return next((s.transfer_function for s in self.stages if isinstance(s, LinearDynamics)), sp.S.One)

    # ------------------------------------------------------------------------------------ the tool's wrench

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
        return self.reading(*self.wrench())

    def equilibrium(self) -> sp.Matrix:
        """Residual of the deflection's equation of motion, in the deflection signals; empty for a rigid mounting."""
        return sp.zeros(0, 1) if self.deflection is None else self.deflection.equilibrium(self.wrench()[1])

    def reading(self, force: sp.Matrix, torque: sp.Matrix) -> sp.Matrix:
        """The load of a wrench of the sensor on the tool (sensor frame)."""
        return reduce(lambda reading, stage: stage.map(reading), self.maps, sp.Matrix.vstack(force, torque))


AnyStage = TypeVar("AnyStage", bound=ChainStage)


def _dynamic(stage: ChainStage) -> bool:
    return stage.place.number > Stage.NONLINEARITY.number


def rigid_chain(
    space: Space,
    *,
    gravity: float,
    sign: tuple[int, ...],
    bias: sp.Matrix,
    mounting: sp.Matrix,
    arm: PerturbedArm | None = None,
) -> Chain:
    """The chain without effects: a rigid tool under gravity (m/s²), readings with the given signs."""
    sensor = (Mounting(mounting, tuple(space.rows)), Gain(sp.eye(len(space.channels)), sign), Bias(bias))
    return Chain(space=space, gravity=-sp.Float(gravity) * space.up, body=rigid_body(space), stages=sensor, arm=arm)


def point_on_tip(chain: Chain, distance: sp.Expr) -> sp.Matrix:
    """The point at `distance` (m) along the tip from the sensor origin, in the sensor frame."""
    return distance * chain.space.tip_axis


def velocity_of_point(chain: Chain, point: sp.Matrix) -> sp.Matrix:
    """Velocity (m/s) in the world of a point r of the tool (m, sensor frame), in that frame: R' v + omega x r."""
    motion = chain.motion
    return motion.rotation.T * motion.velocity + motion.omega.cross(point)


def world_vector(space: Space, *components: sp.Expr) -> sp.Matrix:
    """World vector, padded with zeros to three components."""
    return vector(*components, *([0] * (3 - len(components))))
