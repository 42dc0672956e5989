"""Bend: the tool on a rotational spring and damper at the sensor, turned against it by what it weighs and how it moves.

The sensor moves as it is told; the tool turns about the sensor's origin by an angle of its own. Newton-Euler holds for
the tool in its own axes and with its own motion; the spring and the damper are all that can hold it,

    T = -stiffness theta - damping omega_rel        (sensor on tool, about the origin, sensor axes, N m)

with theta the angle times the axis of the turn (rad) and omega_rel the tool's angular velocity against the sensor.
That is the equation of motion of the bend. Divided by the stiffness it goes over into theta = 0 when that is infinite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from modeling import symbolic as sp
from modeling.space import Motion, Space, signals, turned, vector
from modeling.steps import Definitions, Steps

ARCTANGENT_TERMS = 12
"""Terms of theta's series: exact to rounding up to 0.5 rad, to 1e-9 at 1 rad, where no tool is left to be spoken of."""


@dataclass(frozen=True)
class Bend:
    """The turn of the tool against the sensor, in terms of the signals `bend`, their rates and second rates.

    Plane: bend is the angle about e3 (rad, clockwise). Six axes: bend_x, bend_y, bend_z are 2 tan(theta/2) times the
    axis of the turn, sensor axes; they have no singularity below half a turn, and for small turns are the angles.
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
        """Their derivatives in time, rad/s."""
        return signals(*(f"d{name}" for name in _names(self.space)))

    @property
    def accelerations(self) -> tuple[sp.Symbol, ...]:
        """Their second derivatives in time, rad/s²."""
        return signals(*(f"dd{name}" for name in _names(self.space)))

    @property
    def signals(self) -> tuple[sp.Symbol, ...]:
        """Angles, rates and accelerations, in this order."""
        return self.angles + self.rates + self.accelerations

    @cached_property
    def shape(self) -> Shape:
        """The turn and all that follows from it, named, and the steps that the names stand for."""
        return Shape.of(self)

    @property
    def definitions(self) -> Definitions:
        """Steps from the signals of sensor and bend to the names that `motion`, `to_sensor`, `equilibrium` use."""
        return self.shape.definitions

    @property
    def motion(self) -> Motion:
        """The tool's motion, in its own axes."""
        return self.shape.motion

    def to_sensor(self, force: sp.Matrix, torque: sp.Matrix) -> tuple[sp.Matrix, sp.Matrix]:
        """A wrench about the origin from tool axes to sensor axes."""
        return self.shape.turn * force, self.shape.turn * torque

    def equilibrium(self, torque: sp.Matrix) -> sp.Matrix:
        """What has to be zero (rad), (1, 1) or (3, 1): torque/k + theta + (c/k) omega_rel.

        `torque` is what the sensor has to exert on the tool, about the origin, in sensor axes, N m.
        """
        give = 1 / self.stiffness
        balance = give * torque + self.shape.angle + self.damping * give * (self.shape.turn * self.shape.spin)
        return sp.Matrix([balance[axis] for axis in self.space.turns])


@dataclass(frozen=True, eq=False)
class Shape:
    """A bend in names.

    turn    (3, 3) rotation from tool axes to sensor axes
    spin    angular velocity of the tool against the sensor, tool axes, rad/s
    angle   angle times axis of the turn, rad, the same in both axes
    motion  of the tool, in its own axes
    definitions   what the names stand for
    """

    turn: sp.Matrix
    spin: sp.Matrix
    angle: sp.Matrix
    motion: Motion
    definitions: Definitions

    @classmethod
    def of(cls, bend: Bend) -> Shape:
        """omega_tool = Q' omega + omega_rel; and as dQ = Q (omega_rel x),

        alpha_tool = Q' alpha - omega_rel x Q' omega + d omega_rel.
        """
        moving = zip(bend.angles + bend.rates, bend.rates + bend.accelerations, strict=True)
        steps = Steps(dict(moving), prefix="turned_")
        turn, spin, angle = (m.applyfunc(steps.let) for m in _turned(bend, steps))
        sensor = bend.space.motion
        carried = (turn.T * sensor.omega).applyfunc(steps.let)
        alpha = turn.T * sensor.alpha - spin.cross(carried) + spin.applyfunc(steps.rate)
        motion = replace(
            sensor,
            rotation=(sensor.rotation * turn).applyfunc(steps.let),
            omega=(carried + spin).applyfunc(steps.let),
            alpha=alpha.applyfunc(steps.let),
        )
        return cls(turn, spin, angle, motion, steps.definitions)


def _turned(bend: Bend, steps: Steps) -> tuple[sp.Matrix, sp.Matrix, sp.Matrix]:
    """Turn, spin and angle of a bend.

    Six axes, D = 1 / (1 + b²/4): Q = 1 + D (b x + b x b x / 2), omega_rel = D (db - b x db / 2), and the angle is
    2 arctan(|b|/2) b/|b|, by its series in b².
    """
    if bend.space is Space.PLANE:
        return turned(bend.space, bend.angles), vector(0, 0, *bend.rates), vector(0, 0, *bend.angles)
    b, db = vector(*bend.angles), vector(*bend.rates)
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
