"""Effects of geometry: the centre of mass, the base's tilt, joints and link lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, pi
from typing import TYPE_CHECKING, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.errors import InputError
from modeling.parameter import Parameter
from modeling.rigid_body import RigidBody
from modeling.space import Space, rotation_matrix, vector

if TYPE_CHECKING:
    from modeling.kinematics.arm import Arm
    from modeling.kinematics.perturbed_arm import PerturbedArm


# Joint offsets, elasticity and backlash, and link length errors.


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect with a parameter for each joint; `units` of the joint coordinates are set by the model's arm."""

    units: tuple[str, ...] = ("rad", "rad", "rad")

    stage = Stage.JOINTS
    needs_joints = True

    def fitting(self, arm: Arm | None) -> Self:
        """The effect for the joints of that arm; unchanged without one."""
        return self if arm is None else replace(self, units=arm.units)

    def numbered(self, name: str, units: Sequence[str], bounds: tuple[float, float]) -> tuple[Parameter, ...]:
        """A parameter for each joint, numbered from 1."""
        return tuple(Parameter(name=f"{name}_{j}", unit=u, bounds=bounds) for j, u in enumerate(units, start=1))

    def arm_of(self, chain: Chain) -> PerturbedArm:
        """The chain's arm.

        Raises InputError for a model without an arm.
        """
        if chain.arm is None:
            raise InputError(
                what=f"{self.id} needs the arm",
                where="model",
                remedy="build the model from a rig with link_lengths or a urdf",
            )
        return chain.arm


@dataclass(frozen=True)
class JointOffset(JointEffect):
    """Offset of each joint's zero: true = recorded + offset_j (rad; m if prismatic), positive forward.

    It acts on pose, acceleration and the direction of gravity. The offset of a planar arm's first joint is
    indistinguishable from `gravity_tilt`.
    """

    id = "joint_offset"
    title = "offset of the joint angles"
    equation = "q_j = recorded_j + offset_j"
    advice = "move each joint to its mastering mark and check the zero"
    confused_with = "gravity_tilt, identical to the first joint's offset of a planar arm"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """offset_j in rad."""
        return self.numbered("offset", self.units, (-pi / 4, pi / 4))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift every joint."""
        return replace(chain, arm=replace(self.arm_of(chain), offsets=tuple(p.values())))


@dataclass(frozen=True)
class JointElasticity(JointEffect):
    """Each joint deflects under the tool's weight: true = recorded + compliance_j T_j, in the load's direction.

    T_j (N m) is the static torque of the tool's weight about the joint, at the deflected angle, and compliance_j in
    rad/(N m) is positive. Deflection by the weight of the links is assumed calibrated, or is aliased with an offset.
    """

    id = "joint_elasticity"
    title = "joints deflect under the tool's weight"
    equation = "q_j = recorded_j + compliance_j T_j(weight)"
    advice = "hang a known weight on the tool and measure how far it sinks"
    confused_with = "joint_offset and gravity_tilt, if the load hardly changes"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """compliance_j in rad/(N m), m/N of a prismatic joint."""
        per_load = {"rad": "rad/(N m)", "m": "m/N"}
        return self.numbered("compliance", [per_load[unit] for unit in self.units], (0.0, 0.1))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the compliances."""
        return replace(chain, arm=replace(self.arm_of(chain), compliances=tuple(p.values())))


@dataclass(frozen=True)
class JointBacklash(JointEffect):
    """Each joint rests at the end of its backlash towards which the tool's weight pulls it: recorded ± width_j/2, rad.

    With T_j the static torque of the tool's weight about the joint, true = recorded + width_j/2 sign(T_j), width_j
    positive; sign is smoothed within 0.02 N m of zero. The impact at the crossing is not modelled.
    """

    id = "joint_backlash"
    title = "backlash in the joints"
    equation = "q_j = recorded_j + width_j/2 sign(T_j(weight))"
    advice = "hold the joints and shake the tool by hand: it moves freely before the joint resists"
    confused_with = (
        "joint_elasticity, if the load hardly changes; sensor_hysteresis, which depends on the load at the sensor"
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """width_j in rad, m of a prismatic joint."""
        return self.numbered("width", self.units, (0.0, 0.5))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the backlash widths."""
        return replace(chain, arm=replace(self.arm_of(chain), widths=tuple(p.values())))


@dataclass(frozen=True)
class LinkLengthError(JointEffect):
    """Each link is longer than described by error_j (m), from joint j to the next, the last one to the sensor origin.

    It changes position, velocity and acceleration of the sensor origin. In six axes the link is the offset from one
    joint's frame to the next.
    """

    id = "link_length_error"
    title = "link length errors"
    stage = Stage.KINEMATICS
    equation = "l_j = described_j + error_j"
    advice = "compare the kinematic table with the robot's data sheet"
    confused_with = "crosstalk from fx to tau, identical to the last link's error; sensor_gain"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """error_j in m."""
        return self.numbered("error", ["m"] * len(self.units), (-inf, inf))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the link length errors."""
        return replace(chain, arm=replace(self.arm_of(chain), errors=tuple(p.values())))


# Centre-of-mass offset and tilted base.


@dataclass(frozen=True)
class CentreOfMassOffset(Effect):
    """The tool's centre of mass is off the tip axis.

    The first moment becomes (mlx, -mlg, 0) in the axes (x', -y'): positive mlx (kg m) is along +x'. It adds
    mlx·ddphi to the force along -y', mlx·dphi² along -x', and mlx times the specific force along -y' to the torque.
    """

    id = "com_offset"
    title = "centre of mass off the tip axis"
    stage = Stage.TIP_BODY
    equation = "c = mlg y' + mlx x'"
    advice = "record static poses: the torque follows the direction of gravity; look for a gripper mounted off axis"
    confused_with = "the offset of the last joint and crosstalk from fy to tau, in slow motion"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mlx in kg m."""
        return (Parameter(name="mlx", unit="kg m"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift the first moment along x'."""
        body = chain.body
        return replace(chain, body=RigidBody(body.mass, body.first_moment + vector(p["mlx"], 0, 0), body.inertia))


@dataclass(frozen=True)
class GravityTilt(Effect):
    """The base is not level: gravity is rotated relative to the world frame of the motion.

    In the plane g becomes g (-sin angle, -cos angle): positive angle (rad) rotates it clockwise, as on a base whose -x
    side is lower. In six axes it is rotated about the world's x, then y, by tilt_x, tilt_y (rad), right-handed:
    positive tilt_x leans gravity towards +y, as on a base whose +y side is lower, positive tilt_y towards -x. The base
    itself is turned by the negative of these angles against the horizontal.
    """

    id = "gravity_tilt"
    title = "base not level"
    stage = Stage.TIP_BODY
    equation = "g -> R(angle) g"
    advice = "put a level on the robot's base; compare with the mounting that the controller assumes"
    confused_with = "the first joint's offset, identical for the tool of a planar arm; a cable with a distant anchor"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, two in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("tilt_x", "tilt_y")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi / 4, pi / 4)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Rotate the gravity vector."""
        if chain.space is Space.PLANE:
            rotation = rotation_matrix(chain.space, (-p["angle"],))
        else:
            rotation = rotation_matrix(chain.space, (p["tilt_x"], p["tilt_y"], sp.S.Zero))
        return replace(chain, gravity=rotation * chain.gravity)
