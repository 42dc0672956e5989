"""Effects of geometry: joints and link lengths, the centre of mass, the base's tilt, a tool that bends at its root."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, pi, sqrt
from typing import TYPE_CHECKING, ClassVar, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.dynamics.deflection import Deflection
from modeling.errors import InputError
from modeling.parameter import Parameter, Role
from modeling.rigid_body import RigidBody
from modeling.sketch import Arc, Arrow, Circle, Ground, Length, Line, Links, Name, Text, Tool
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

    def numbered(
        self, name: str, units: Sequence[str], bounds: tuple[float, float], meaning: str
    ) -> tuple[Parameter, ...]:
        """A parameter for each joint, numbered from 1; `{}` of the meaning is its number."""
        return tuple(
            Parameter(name=f"{name}_{j}", unit=unit, meaning=meaning.format(j), bounds=bounds)
            for j, unit in enumerate(units, start=1)
        )

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
    shows = "A small turn of the whole weight and of the acceleration, constant over time and different for each joint."
    provoked_by = (
        "Move one joint at a time, with the others in several poses; fast motion separates the joints, because each "
        "offset turns another acceleration."
    )
    amounts: ClassVar[Mapping[str, float]] = {"rad": 0.02, "m": 0.02}
    sketch = (
        Ground(),
        Links(hand=(196, 60), kind="ghost"),
        Links(hand=(186, 100)),
        Text(232, 48, "recorded", "end"),
        Text(192, 114, "true"),
        Arc(112, 52, 52, 6, 34),
        Name(172, 82, "offset_j"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """offset_j in rad."""
        return self.numbered("offset", self.units, (-pi / 4, pi / 4), "true minus recorded coordinate of joint {}")

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
    shows = "Like a joint offset that follows the load: largest where the arm is stretched out horizontally."
    provoked_by = (
        "The same poses with and without a known extra weight: the difference grows with the weight, that of an "
        "offset does not."
    )
    amounts: ClassVar[Mapping[str, float]] = {"rad/(N m)": 0.001, "m/N": 0.001}
    sketch = (
        Ground(),
        Links(hand=(196, 56), kind="ghost"),
        Links(hand=(190, 84)),
        Arrow((190, 86), (190, 124), "ink"),
        Text(196, 122, "weight"),
        Arc(112, 52, 14, -150, 150),
        Name(100, 32, "compliance_j", "middle"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """compliance_j in rad/(N m), m/N of a prismatic joint."""
        per_load = {"rad": "rad/(N m)", "m": "m/N"}
        units = [per_load[unit] for unit in self.units]
        return self.numbered("compliance", units, (0.0, 0.1), "deflection of joint {} for each unit of load")

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
    shows = "A step where the torque of the weight about the joint changes its sign, constant on either side."
    provoked_by = "Swing each joint slowly through the pose in which its load changes sign, from both sides."
    amounts: ClassVar[Mapping[str, float]] = {"rad": 0.01, "m": 0.01}
    sketch = (
        Ground(),
        Links(hand=(196, 44), kind="ghost"),
        Links(hand=(184, 98)),
        Arc(112, 52, 62, -6, 32),
        Name(182, 68, "width_j"),
        Text(232, 120, "rests where the weight pulls it", "end"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """width_j in rad, m of a prismatic joint."""
        return self.numbered("width", self.units, (0.0, 0.5), "free travel of joint {}")

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
    shows = (
        "In proportion to the acceleration of the link's end: nothing at rest, quadratic in the speed of the motion."
    )
    provoked_by = "Fast rotation of the joint before the link, with the joints behind it held in different poses."
    amounts: ClassVar[Mapping[str, float]] = {"m": 0.02}
    sketch = (
        Ground(),
        Links(hand=(166, 64)),
        Line(((166, 64), (206, 73)), "accent"),
        Circle(206, 73, 3, "accent dot"),
        Length((162, 82), (202, 91), Name(182, 108, "error_j", "middle")),
        Text(130, 44, "as described"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """error_j in m."""
        return self.numbered("error", ["m"] * len(self.units), (-inf, inf), "true minus described length of link {}")

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
    shows = (
        "A torque in proportion to gravity's component along the tip, at rest as in motion, and nothing in the forces"
        " as long as the motion is slow."
    )
    provoked_by = (
        "Static poses all around the circle: the torque is a sine of the angle, and its phase is off by the direction"
        " of the offset. Fast rotation adds a force that separates it from crosstalk."
    )
    amounts: ClassVar[Mapping[str, float]] = {"mlx": 0.01}
    sketch = (
        Tool(),
        Line(((120, 28), (120, 144)), "faint"),
        Circle(152, 84, 5, "accent dot"),
        Text(162, 88, "centre of mass"),
        Length((120, 102), (152, 102), Name(160, 112, "mlx / m")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mlx in kg m."""
        return (
            Parameter(
                name="mlx",
                unit="kg m",
                meaning="mass times the distance of the centre of mass from the tip axis",
            ),
        )

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
    shows = "Sine and cosine of the orientation in the force channels, independent of speed."
    provoked_by = (
        "Many orientations at one position, held still: a tether changes with position, a tilted gravity does not."
    )
    amounts: ClassVar[Mapping[str, float]] = {"rad": 0.05}
    sketch = (
        Line(((46, 90), (172.1, 121.4))),
        Text(44, 84, "base", "end"),
        Arrow((120, 26), (120, 104)),
        Text(126, 100, "g"),
        Line(((120, 26), (100.6, 103.6)), "ghost"),
        Text(120, 144, "dashed: perpendicular to the base", "middle"),
        Arc(120, 26, 46, 90, 104),
        Name(128, 62, "angle; tilt_x, tilt_y"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, two in six axes, rad."""
        turned = "angle by which gravity is turned"
        meanings = (
            {"angle": f"{turned} clockwise: positive, the base's -x side is lower"}
            if space is Space.PLANE
            else {
                "tilt_x": f"{turned} about the world's x: positive, the base's +y side is lower",
                "tilt_y": f"{turned} about the world's y: positive, the base's -x side is lower",
            }
        )
        return tuple(
            Parameter(name=name, unit="rad", meaning=words, bounds=(-pi / 4, pi / 4))
            for name, words in meanings.items()
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Rotate the gravity vector."""
        if chain.space is Space.PLANE:
            rotation = rotation_matrix(chain.space, (-p["angle"],))
        else:
            rotation = rotation_matrix(chain.space, (p["tilt_x"], p["tilt_y"], sp.S.Zero))
        return replace(chain, gravity=rotation * chain.gravity)


@dataclass(frozen=True)
class GravityMagnitude(Effect):
    """Gravity at the place is stronger than stated by error (m/s²), in the stated direction.

    It scales every moment of the tool at rest, and no recording tells it from the mass: a budget states it.
    """

    id = "gravity"
    title = "gravity at the place"
    stage = Stage.KINEMATICS  # before a tilt turns it
    equation = "g -> (|g| + error) g/|g|"
    advice = (
        "look up gravity at the place: it changes by 0.5 % from the equator to the poles, and by 0.03 % a kilometre"
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """error in m/s²."""
        return (Parameter(name="error", unit="m/s²", meaning="true minus stated gravity"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Lengthen gravity."""
        return replace(chain, gravity=chain.gravity - p["error"] * chain.space.up)


# The tool on a rotational spring and damper at the sensor.


LOWEST_STIFFNESS = 1.0
"""Lower bound of the stiffness (N m/rad): 0.1 kg at 0.1 m would deflect it by six degrees."""

HIGHEST_STIFFNESS = 1e4
"""Upper end of the stiffness grid (N m/rad): a torque of 10 N m rotates the tool by a milliradian."""

NATURAL_FREQUENCIES = (2.0, 40.0)
"""Range of natural frequencies (Hz) of the grid: softer mountings droop, stiffer ones are not identifiable."""

TYPICAL_MASS = 1.0
"""Mass (kg) of a tool on a wrist sensor, for the order of magnitude of an unknown inertia."""


@dataclass(frozen=True)
class TipFlexibility(Effect):
    """The tool is mounted on a rotational spring and damper at the sensor's origin.

    The torque of the sensor on the tool about the origin is -stiffness theta - damping omega_rel (N m), theta the
    rotation vector (rad; the angle in the plane) of the tool relative to the sensor and omega_rel the relative angular
    velocity; weight, inertia and applied forces rotate with the tool (`modeling.dynamics.deflection`). The effect
    vanishes as 1/stiffness.
    """

    id = "tip_flexibility"
    title = "tip on a spring and damper"
    stage = Stage.DEFLECTION
    equation = "T = -stiffness theta - damping dtheta/dt, theta the rotation of the tool relative to the sensor"
    advice = "tap the tool and watch it ring; push it by hand and measure its rotation; tighten the flange's screws"
    confused_with = "joint_elasticity and gain_nonlinearity, in slow motion; sensor_lag, which never overshoots"
    shows = (
        "In proportion to the second derivative of the wrench: grows with the square of the frequency, and rings "
        "after a knock."
    )
    provoked_by = "A motion with frequencies as high as the robot allows, or a knock on the tool while it is recorded."
    amounts: ClassVar[Mapping[str, float]] = {"stiffness": 50.0, "damping": 0.1}
    sketch = (
        Tool(kind="ghost"),
        Tool(turn=-20),
        Arc(120, 28, 62, 70, 90),
        Text(130, 106, "θ"),
        Arc(120, 34, 16, -50, 110),
        Name(146, 30, "stiffness,"),
        Name(146, 44, "damping"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Stiffness in N m/rad, infinite for a rigid mounting, and damping in N m s/rad."""
        return (
            Parameter(
                name="stiffness",
                unit="N m/rad",
                meaning="torque for each unit of deflection",
                nominal=inf,
                bounds=(LOWEST_STIFFNESS, inf),
                start=300.0,
            ),
            Parameter(
                name="damping",
                unit="N m s/rad",
                meaning="torque for each unit of its rate",
                bounds=(0.0, inf),
                role=Role.SHAPE,
                start=1.0,
            ),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Mount the tool on the spring."""
        return replace(chain, deflection=Deflection(chain.space, p["stiffness"], p["damping"]))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Natural frequencies of 2 to 40 Hz, each with a damping ratio of 0.05 and 0.5.

        stiffness = inertia (2 pi f)², damping = 2 ratio sqrt(stiffness inertia); for an unknown inertia, that of
        a rod as long as `reach`.
        """
        import numpy as np

        inertia = domain.inertia or TYPICAL_MASS * domain.reach**2 / 3
        stiffnesses = np.clip(
            inertia * (2 * np.pi * np.geomspace(*NATURAL_FREQUENCIES, 8)) ** 2, LOWEST_STIFFNESS, HIGHEST_STIFFNESS
        )
        return tuple(
            {"stiffness": float(k), "damping": 2 * ratio * sqrt(k * inertia)}
            for k, ratio in product(stiffnesses, (0.05, 0.5))
        )
