"""Effects of the arm: where its joints and links really are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, pi
from typing import TYPE_CHECKING, Self

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.effect import Effect
from modeling.errors import InputError
from modeling.parameter import Parameter
from modeling.space import Space

if TYPE_CHECKING:
    from modeling.actual_arm import ActualArm
    from modeling.kinematics import Arm


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect of each joint. `units` are those of the joints' coordinates, known once a model with an arm has it."""

    units: tuple[str, ...] = ("rad", "rad", "rad")

    stage = Stage.JOINTS
    needs_joints = True

    def fitting(self, arm: Arm | None) -> Self:
        """The effect for the joints of that arm; as it is without one."""
        return self if arm is None else replace(self, units=arm.units)

    def numbered(self, name: str, units: Sequence[str], bounds: tuple[float, float]) -> tuple[Parameter, ...]:
        """A parameter for each joint, numbered from 1."""
        return tuple(Parameter(name=f"{name}_{j}", unit=u, bounds=bounds) for j, u in enumerate(units, start=1))

    def arm_of(self, chain: Chain) -> ActualArm:
        """The chain's arm.

        Raises InputError when the model was made without one.
        """
        if chain.arm is None:
            raise InputError(
                what=f"{self.id} needs the arm",
                where="model",
                remedy="make the model of a rig with link_lengths or a urdf",
            )
        return chain.arm


@dataclass(frozen=True)
class JointOffset(JointEffect):
    """The zero of each joint is elsewhere: true = recorded + offset_j, rad (m where a joint slides), positive forward.

    All that follows from the angle is turned with it: pose, acceleration and the direction of gravity. That of the
    first joint of a planar arm is a tilted base seen from the tool, and cannot be told from `gravity_tilt`.
    """

    id = "joint_offset"
    title = "joint angles count from a wrong zero"
    equation = "q_j = recorded_j + offset_j"
    advice = "move each joint to its mastering mark"
    confused_with = "gravity_tilt: to the tool of a planar arm the first joint's offset is the same"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """offset_j in rad."""
        return self.numbered("offset", self.units, (-pi / 4, pi / 4))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift every joint."""
        return replace(chain, arm=replace(self.arm_of(chain), offsets=tuple(p.values())))


@dataclass(frozen=True)
class JointElasticity(JointEffect):
    """Each joint gives way to the weight of the tool: true = recorded + compliance_j T_j, in the load's direction.

    T_j (N m) is the static torque of the tool's weight about the joint, at the angle where it really stands, and
    compliance_j in rad/(N m) is positive. The weight of the links is not the tool's: what it does is calibrated away,
    or looks like an offset.
    """

    id = "joint_elasticity"
    title = "joints give way to the tool's weight"
    equation = "q_j = recorded_j + compliance_j T_j(weight)"
    advice = "hang a known weight on the tool and measure how far it sinks"
    confused_with = "joint_offset and gravity_tilt, where the load hardly changes"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """compliance_j in rad/(N m), m/N where a joint slides."""
        units = ["m/N" if unit == "m" else "rad/(N m)" for unit in self.units]
        return self.numbered("compliance", units, (0.0, 0.1))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Let every joint give way."""
        return replace(chain, arm=replace(self.arm_of(chain), compliances=tuple(p.values())))


@dataclass(frozen=True)
class JointBacklash(JointEffect):
    """Each joint lies at that end of its play towards which the tool's weight pulls it: recorded ± width_j/2, rad.

    With T_j the static torque of the tool's weight about the joint, true = recorded + width_j/2 sign(T_j), width_j
    positive; sign is rounded off within 0.02 N m of zero. The knock of passing over is not modelled.
    """

    id = "joint_backlash"
    title = "play in the joints"
    equation = "q_j = recorded_j + width_j/2 sign(T_j(weight))"
    advice = "hold the joints and shake the tool by hand: it moves without a load before the joint gives way"
    confused_with = (
        "joint_elasticity, where the load hardly changes; sensor_hysteresis, which follows the load at the sensor"
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """width_j in rad, m where a joint slides."""
        return self.numbered("width", self.units, (0.0, 0.5))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Put every joint at one end of its play."""
        return replace(chain, arm=replace(self.arm_of(chain), widths=tuple(p.values())))


@dataclass(frozen=True)
class LinkLengthError(JointEffect):
    """Each link is longer than described by error_j (m), from joint j to the next, the last one to the sensor origin.

    It changes the path and acceleration of the sensor origin, and with them whatever follows from its velocity. In six
    axes the way from one joint's frame to the next counts as the link.
    """

    id = "link_length_error"
    title = "links of another length"
    stage = Stage.KINEMATICS
    equation = "l_j = described_j + error_j"
    advice = "compare the kinematic table with the robot's data sheet"
    confused_with = "a leak of fx into tau, which is the same as the last link's error; sensor_gain"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """error_j in m."""
        return self.numbered("error", ["m"] * len(self.units), (-inf, inf))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Stretch every link."""
        return replace(chain, arm=replace(self.arm_of(chain), errors=tuple(p.values())))
