"""Tool on a rotational spring and damper at the sensor: kinematics and equation of motion of the deflection.

The motion of the sensor is given; the tool rotates relative to it about the sensor's origin. The Newton-Euler equations
of the tool, in tool axes and with the tool's motion, balance the torque of spring and damper,

    T = -stiffness theta - damping omega_rel        (sensor on tool, about the origin, sensor axes, N m)

with theta the rotation vector (rad) and omega_rel the angular velocity of the tool relative to the sensor. This is the
equation of motion of the deflection. Divided by the stiffness it becomes theta = 0 for an infinite stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import Definitions, IntermediateVariables
from modeling.space import SensorMotion, Space, rotation_matrix, signals, vector

ARCTANGENT_TERMS = 12
"""Terms of theta's series: exact to rounding up to 0.5 rad, to 1e-9 at 1 rad, beyond any realistic deflection."""


@dataclass(frozen=True)
class Deflection:
    """Rotation of the tool relative to the sensor, in terms of the signals `bend`, their first and second derivatives.

    Plane: bend is the angle about e3 (rad, clockwise). Six axes: bend_x, bend_y, bend_z are 2 tan(theta/2) times the
    axis of rotation, sensor axes (Rodrigues parameters); not singular below 180°, and the angles of small rotations.
    """

    space: Space
    stiffness: sp.Expr
    damping: sp.Expr

    @property
    def angles(self) -> tuple[sp.Symbol, ...]:
        """bend, or bend_x, bend_y, bend_z."""
        return signals(*_names(self.space))

    @property
    def rates(self) -> tuple[sp.Symbol, ...]:
        """Time derivatives of the angles, rad/s."""
        return signals(*(f"d{name}" for name in _names(self.space)))

    @property
    def accelerations(self) -> tuple[sp.Symbol, ...]:
        """Second time derivatives of the angles, rad/s²."""
        return signals(*(f"dd{name}" for name in _names(self.space)))

    @property
    def signals(self) -> tuple[sp.Symbol, ...]:
        """Angles, rates and accelerations, in this order."""
        return self.angles + self.rates + self.accelerations

    @cached_property
    def shape(self) -> DeflectedMotion:
        """Rotation and tool motion in intermediate variables, with their definitions."""
        return DeflectedMotion.of(self)

    @property
    def definitions(self) -> Definitions:
        """Intermediate variables of `motion`, `to_sensor` and `equilibrium`, from sensor motion and deflection."""
        return self.shape.definitions

    @property
    def motion(self) -> SensorMotion:
        """The tool's motion, in tool axes."""
        return self.shape.motion

    def to_sensor(self, force: sp.Matrix, torque: sp.Matrix) -> tuple[sp.Matrix, sp.Matrix]:
        """A wrench about the origin, rotated from tool axes to sensor axes."""
        return self.shape.turn * force, self.shape.turn * torque

    def equilibrium(self, torque: sp.Matrix) -> sp.Matrix:
        """Residual (rad) of the equation of motion, (1, 1) or (3, 1): torque/k + theta + (c/k) omega_rel.

        `torque` is the Newton-Euler torque of the sensor on the tool, about the origin, in sensor axes, N m.
        """
        compliance = 1 / self.stiffness
        omega_rel = self.shape.turn * self.shape.spin
        balance = compliance * torque + self.shape.angle + self.damping * compliance * omega_rel
        return sp.Matrix([balance[axis] for axis in self.space.turns])


@dataclass(frozen=True, eq=False)
class DeflectedMotion:
    """Deflection and tool motion in intermediate variables.

    turn    (3, 3) rotation matrix from tool axes to sensor axes
    spin    angular velocity of the tool relative to the sensor, tool axes, rad/s
    angle   rotation vector, rad, the same in both axes
    motion  of the tool, in tool axes
    definitions   of the intermediate variables
    """

    turn: sp.Matrix
    spin: sp.Matrix
    angle: sp.Matrix
    motion: SensorMotion
    definitions: Definitions

    @classmethod
    def of(cls, deflection: Deflection) -> DeflectedMotion:
        """omega_tool = Q' omega + omega_rel; and as dQ = Q (omega_rel x),

        alpha_tool = Q' alpha - omega_rel x Q' omega + d omega_rel.
        """
        derivatives = zip(
            deflection.angles + deflection.rates, deflection.rates + deflection.accelerations, strict=True
        )
        steps = IntermediateVariables(dict(derivatives), prefix="turned_")
        turn, spin, angle = (m.applyfunc(steps.let) for m in _rotation(deflection, steps))
        sensor = deflection.space.motion
        sensor_rate = (turn.T * sensor.omega).applyfunc(steps.let)
        alpha = turn.T * sensor.alpha - spin.cross(sensor_rate) + spin.applyfunc(steps.rate)
        motion = replace(
            sensor,
            rotation=(sensor.rotation * turn).applyfunc(steps.let),
            omega=(sensor_rate + spin).applyfunc(steps.let),
            alpha=alpha.applyfunc(steps.let),
        )
        return cls(turn, spin, angle, motion, steps.definitions)


def _rotation(deflection: Deflection, steps: IntermediateVariables) -> tuple[sp.Matrix, sp.Matrix, sp.Matrix]:
    """Rotation matrix, relative angular velocity and rotation vector of a deflection.

    Six axes, D = 1 / (1 + b²/4): Q = 1 + D (b x + b x b x / 2), omega_rel = D (db - b x db / 2), and the angle is
    2 arctan(|b|/2) b/|b|, by its series in b².
    """
    if deflection.space is Space.PLANE:
        return (
            rotation_matrix(deflection.space, deflection.angles),
            vector(0, 0, *deflection.rates),
            vector(0, 0, *deflection.angles),
        )
    b, db = vector(*deflection.angles), vector(*deflection.rates)
    square = steps.let(b.dot(b) / 4)
    shrinkage = steps.let(1 / (1 + square))
    cross = b.hat()
    series = sp.S.Zero
    for term in reversed(range(ARCTANGENT_TERMS)):
        series = sp.Rational((-1) ** term, 2 * term + 1) + series * square
    turn = sp.eye(3) + shrinkage * (cross + cross * cross / 2)
    return turn, shrinkage * (db - b.cross(db) / 2), steps.let(series) * b


def _names(space: Space) -> tuple[str, ...]:
    return ("bend",) if space is Space.PLANE else ("bend_x", "bend_y", "bend_z")
