"""Loads on the tool: drag, friction, a cable, a force that keeps its direction in the base, a spinning rotor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import dist, inf
from typing import ClassVar, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, velocity_of_point, world_vector
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.parameter import Parameter, Role
from modeling.sketch import Arc, Arrow, Axes, Box, Circle, Length, Line, Name, Sketch, Text, Tool
from modeling.space import Space, vector

# Effects that act at a point of the tool, and a force of the environment there.


SMOOTHING_SPEED = 1e-6
"""Speed (m/s) or length (m) below which |v| is smoothed, so that it has a derivative at zero."""

TIP_DISTANCE = Parameter(
    name="d",
    unit="m",
    meaning="distance of the point from the sensor, along the tip",
    bounds=(-0.5, 1.5),
    role=Role.SHAPE,
)
OFFSETS = tuple(
    Parameter(
        name=name,
        unit="m",
        meaning=f"place of the point across the tip, along the {name} axis of the logged pose",
        bounds=(-0.5, 0.5),
        role=Role.SHAPE,
    )
    for name in ("x", "y")
)
"""Position beside the tip axis, along x and y of the logged pose: as far as a tool reaches."""
ON_AXIS = tuple(replace(p, bounds=(0.0, 0.0)) for p in OFFSETS)
POINT_AMOUNTS = {"x": 0.03, "y": -0.02, "d": 0.12}
"""Where a point is in tests of an effect (`amounts`): within a tool, off its axis."""


@dataclass(frozen=True)
class PointEffect(Effect):
    """An effect that acts at a point of the tool: at d along the tip in the plane, at (x, y, d) in six axes.

    With `on_axis`, x and y are fixed at 0 in six axes, too; in the plane it has no meaning. A diagnosis searches on the
    axis: there an effect has the forces that it has 3 cm beside it, nearly, and a test of one amplitude needs less of
    it than one of three. x and y are then tested given all others.
    """

    on_axis: bool = False

    def point_parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coordinates of the point along the axes of the logged pose, m: d in the plane; x, y, d in six axes."""
        if space is Space.PLANE:
            return (TIP_DISTANCE,)
        return (*(ON_AXIS if self.on_axis else OFFSETS), TIP_DISTANCE)

    def restricted(self, space: Space) -> Self:
        """The effect at a point on the tip axis."""
        return self if space is Space.PLANE else replace(self, on_axis=True)

    def unrestricted(self, space: Space) -> Self:
        """The effect at any point."""
        return self if space is Space.PLANE else replace(self, on_axis=False)


def point_of_application(chain: Chain, p: Mapping[str, sp.Expr]) -> sp.Matrix:
    """The point (m, sensor frame) of the coordinates among the parameters `p` of a `PointEffect`."""
    return point_on_tip(chain, p["d"]) + vector(p.get("x", 0), p.get("y", 0), 0)


def with_force(chain: Chain, force: sp.Matrix, point: sp.Matrix) -> Chain:
    """The chain with `force` (N, sensor frame, on the tool) acting at a `point` (m, sensor frame)."""
    return replace(chain, force=chain.force + force, torque=chain.torque + point.cross(force))


def tip_distances(domain: SearchDomain) -> list[float]:
    """Grid of points of application along the tip, m."""
    import numpy as np

    return [float(d) for d in np.linspace(0.0, domain.reach, 5)]


# Viscous, quadratic and Coulomb friction on the tool.


NARROW = 1e-3
"""Speed (rad/s or m/s) over which dry friction changes its sign where no other is estimated: above the noise of a
velocity at rest, whose sign means nothing, and passed within a sample by most motions."""
START_WIDTH = 1e-2
"""Width that its search begins at: a narrow one has no derivative where the motion passes it within a sample."""
WIDEST = 1.0
"""Width (rad/s or m/s) above which the friction of most motions is a viscous drag."""


@dataclass(frozen=True)
class DryFriction(Effect):
    """Friction of constant size against a velocity, whose sign changes over a width: tanh(speed / width).

    With `narrow`, the width is fixed at 0.001. A diagnosis searches with that, as few samples tell more, and frees the
    width where they do.
    """

    narrow: bool = False

    def width(self, unit: str) -> Parameter:
        """The speed at which it has three quarters of its size."""
        return Parameter(
            name="width",
            unit=unit,
            meaning="speed beside a reversal at which it has three quarters of its size",
            nominal=NARROW,
            bounds=(NARROW, NARROW if self.narrow else WIDEST),
            role=Role.SHAPE,
            start=None if self.narrow else START_WIDTH,
        )

    def restricted(self, space: Space) -> Self:
        """The effect with the narrow step, at a point on the tip axis if it has one."""
        return replace(super().restricted(space), narrow=True)

    def unrestricted(self, space: Space) -> Self:
        """The effect of any width, at any point."""
        return replace(super().unrestricted(space), narrow=False)


def friction_direction(velocity: sp.Matrix, width: sp.Expr) -> sp.Matrix:
    """The velocity's direction times the share of the friction that acts at its size."""
    speed = sp.sqrt(velocity.dot(velocity) + SMOOTHING_SPEED**2)
    return sp.tanh(speed / width) / speed * velocity


def _drag(force: str) -> Sketch:
    """The sketch of a force against the velocity of a point of the tool."""
    return (
        Tool(),
        Circle(120, 108, 3, "accent dot"),
        Arrow((134, 108), (200, 108), "ink"),
        Text(204, 112, "v"),
        Arrow((120, 108), (52, 108)),
        Name(84, 126, force, "middle"),
        Line(((126, 28), (166, 28)), "faint"),
        Length((158, 28), (158, 106), Name(164, 72, "d")),
    )


@dataclass(frozen=True)
class ViscousDrag(PointEffect):
    """A force against the velocity of a point of the tool: F = -c v (on the tool, N).

    c in N s/m is positive (dissipative). The point r is at the distance d (m) along the tip; in six axes it is
    (x, y, d) in the sensor frame. The torque about the sensor is r x F.
    """

    id = "viscous_drag"
    title = "drag proportional to speed"
    stage = Stage.TIP_BODY
    equation = "F = -c v(r)"
    advice = "run the same path at half and double speed; look for a hose, a brush or a fluid that the tool moves in"
    confused_with = "quadratic_drag, in a narrow range of speeds; sensor_lag, in motion of one frequency"
    shows = "A force against the velocity, in proportion to it, with a torque by its distance from the sensor."
    provoked_by = "The same path at half, normal and double speed: the residual doubles with the speed."
    amounts: ClassVar[Mapping[str, float]] = {"c": 0.5, **POINT_AMOUNTS}
    sketch = _drag("F = −c v")

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s/m, the point in m."""
        return (
            Parameter(name="c", unit="N s/m", meaning="force for each unit of speed", bounds=(0.0, inf)),
            *self.point_parameters(space),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the drag force to the tool."""
        point = point_of_application(chain, p)
        return with_force(chain, -p["c"] * velocity_of_point(chain, point), point)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Points along the tip."""
        return tuple({"d": d} for d in tip_distances(domain))


@dataclass(frozen=True)
class QuadraticDrag(ViscousDrag):
    """A force against the velocity of a point of the tool, proportional to its square: F = -c |v| v (N).

    c in N s²/m² is positive; |v| is smoothed below 1e-6 m/s. The point r is at the distance d (m) along the tip; in six
    axes it is (x, y, d) in the sensor frame. The torque about the sensor is r x F.
    """

    id = "quadratic_drag"
    title = "drag proportional to speed squared"
    equation = "F = -c |v(r)| v(r)"
    advice = "run the same path at half and double speed: a quarter and four times the force; look for a large plate"
    confused_with = "viscous_drag, in a narrow range of speeds"
    shows = "A force against the velocity that is nearly zero in slow parts and large in fast ones."
    provoked_by = "The same path at half, normal and double speed: the residual grows fourfold when the speed doubles."
    amounts: ClassVar[Mapping[str, float]] = {"c": 0.3, **POINT_AMOUNTS}
    sketch = _drag("F = −c |v| v")

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s²/m², the point in m."""
        return (
            Parameter(name="c", unit="N s²/m²", meaning="force for each unit of speed squared", bounds=(0.0, inf)),
            *self.point_parameters(space),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the quadratic drag force to the tool."""
        point = point_of_application(chain, p)
        velocity = velocity_of_point(chain, point)
        speed = sp.sqrt(velocity.dot(velocity) + SMOOTHING_SPEED**2)
        return with_force(chain, -p["c"] * speed * velocity, point)


@dataclass(frozen=True)
class CoulombFriction(DryFriction):
    """A torque of constant magnitude against the rotation, T = -level omega/|omega|: a hose or cable rubs at the wrist.

    level in N m is positive, omega is the tool's angular velocity in the world. The step at a reversal is
    tanh(|omega| / width), width in rad/s.
    """

    id = "coulomb_friction"
    title = "Coulomb friction torque against the rotation"
    stage = Stage.TIP_BODY
    equation = "T = -level tanh(|omega| / width) omega/|omega|"
    advice = "look for a hose or cable that rubs at the wrist; reverse slowly and fast: the step has the same height"
    confused_with = "sensor_hysteresis of the torque; viscous_drag, at nearly constant speed"
    shows = "A step in the torque wherever the rotation reverses, of the same height at any speed."
    provoked_by = (
        "Reverse slowly and fast in the same pose: a viscous torque changes with the speed, this one does not."
    )
    amounts: ClassVar[Mapping[str, float]] = {"level": 0.05, "width": 0.5}
    sketch = (
        Axes("angular velocity", "torque", centred=True),
        Line(((32, 40), (116, 40), (120, 112), (210, 112)), "accent"),
        Length((62, 40), (62, 76), Name(68, 62, "level")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N m, width in rad/s."""
        meaning = "size of the torque, whatever the angular velocity"
        return (Parameter(name="level", unit="N m", meaning=meaning, bounds=(0.0, inf)), self.width("rad/s"))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the friction torque to the tool."""
        direction = friction_direction(chain.motion.omega, p["width"])
        return replace(chain, torque=chain.torque - p["level"] * direction)


@dataclass(frozen=True)
class TranslationalFriction(DryFriction, ViscousDrag):
    """A force of constant size against the velocity of a point of the tool, F = -level v/|v|: it rubs on something.

    level in N is positive. The step at a reversal is tanh(|v| / width), width in m/s. The point r is at the distance d
    (m) along the tip; in six axes it is (x, y, d) in the sensor frame. The torque about the sensor is r x F.
    """

    id = "translational_friction"
    title = "dry friction against the velocity of the tool"
    equation = "F = -level tanh(|v(r)| / width) v(r)/|v(r)|"
    advice = "look for what the tool, its hose or its cable slides on; run the same path slowly: the force stays"
    confused_with = "viscous_drag, at nearly constant speed; sensor_hysteresis, whose step follows the load"
    shows = "A force against the velocity, of the same size at any speed, with a step where the direction reverses."
    provoked_by = "The same path at half, normal and double speed: the residual keeps its size."
    amounts: ClassVar[Mapping[str, float]] = {"level": 0.8, "width": 0.5, **POINT_AMOUNTS}
    sketch = _drag("level")

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N, width in m/s, the point in m."""
        meaning = "size of the force, whatever the speed"
        return (
            Parameter(name="level", unit="N", meaning=meaning, bounds=(0.0, inf)),
            self.width("m/s"),
            *self.point_parameters(space),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the friction force to the tool."""
        point = point_of_application(chain, p)
        direction = friction_direction(velocity_of_point(chain, point), p["width"])
        return with_force(chain, -p["level"] * direction, point)


# Tension of a cable between the tool and an anchor in the cell.


ANCHOR_BOUNDS = (-5.0, 5.0)
"""Bounds of the anchor (m, each world axis): the robot's cell. A more distant anchor gives a constant force."""


@dataclass(frozen=True)
class CableSpring(PointEffect):
    """A unilateral linear spring pulls a point of the tool towards an anchor.

    With u the vector from the point to the anchor (world, m), F = k max(0, |u| - length) u/|u|: k in N/m,
    length (m) is its natural length. The point is at the distance d (m) along the tip; in six axes it is (x, y, d) in
    the sensor frame.
    """

    id = "cable_spring"
    title = "tether or cable pulling at the tool"
    stage = Stage.TIP_BODY
    equation = "F = k max(0, |u| - length) u/|u|, u = anchor - point"
    advice = "look for a cable or hose that goes taut in part of the workspace; free it and record again"
    confused_with = "gravity_tilt, for a distant anchor; any other force that depends on the position alone"
    shows = "A force that depends on the position alone, zero where the cable is slack."
    provoked_by = "Approach the place where it goes taut from several sides, at one orientation and slowly."
    amounts: ClassVar[Mapping[str, float]] = {
        "k": 10.0,
        "anchor_x": 1.0,
        "anchor_y": 1.2,
        "anchor_z": 0.9,
        "length": 0.8,
        **POINT_AMOUNTS,
    }
    sketch = (
        Tool(),
        Circle(120, 100, 3, "accent dot"),
        Line(
            ((120, 100), (146, 94), (150, 88), (158, 98), (166, 84), (174, 94), (182, 80), (190, 84), (214, 78)),
            "accent",
        ),
        Line(((214, 62), (214, 96))),
        Name(232, 52, "anchor_x, _y, _z", "end"),
        Name(150, 118, "k, length"),
        Line(((80, 28), (114, 28)), "faint"),
        Length((86, 28), (86, 100), Name(80, 70, "d", "end")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """k in N/m; anchor, length and the point in m."""
        stiffness = Parameter(name="k", unit="N/m", meaning="stiffness", bounds=(0.0, inf))
        anchor = tuple(
            Parameter(
                name=f"anchor_{axis}",
                unit="m",
                meaning=f"place of the fixed end along the world's {axis} axis, from its origin (the base)",
                bounds=ANCHOR_BOUNDS,
                role=Role.SHAPE,
            )
            for axis in space.axes
        )
        slack = "length below which the cable is slack"
        length = Parameter(name="length", unit="m", meaning=slack, bounds=(0.0, inf), role=Role.SHAPE)
        return (stiffness, *anchor, length, *self.point_parameters(space))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the spring force to the tool."""
        anchor = world_vector(chain.space, *(p[f"anchor_{a}"] for a in chain.space.axes))
        motion, point = chain.motion, point_of_application(chain, p)
        to_anchor = motion.rotation.T * (anchor - motion.position) - point
        distance = sp.sqrt(to_anchor.dot(to_anchor) + SMOOTHING_SPEED**2)
        stretch = sp.Max(0, distance - p["length"])
        return with_force(chain, p["k"] * stretch / distance * to_anchor, point)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Anchors in and around the workspace of the recording, for cables always taut and taut in part of it."""
        import numpy as np

        if not domain.low:
            return ()
        low, high = np.array(domain.low), np.array(domain.high)
        margin = np.maximum(high - low, 0.3) * 1.5
        count = 8 if len(low) == 2 else 5
        lines = [np.linspace(a, b, count) for a, b in zip(low - margin, high + margin, strict=True)]
        names = [f"anchor_{a}" for a in "xyz"[: len(low)]]
        return tuple(
            dict(zip(names, map(float, anchor), strict=True)) | {"length": length, "d": d}
            for anchor in product(*lines)
            for length in _slack_lengths(anchor, domain)
            for d in (0.0, 0.5 * domain.reach, domain.reach)
        )


def _slack_lengths(anchor: Sequence[float], domain: SearchDomain) -> list[float]:
    """Natural lengths between zero and the farthest corner of the box from the anchor."""
    corners = [dist(corner, anchor) for corner in product(*zip(domain.low, domain.high, strict=True))]
    nearest, farthest = min(corners), max(corners)
    return [0.0, nearest + 0.25 * (farthest - nearest), nearest + 0.6 * (farthest - nearest)]


# A wrench that is constant in base axes, and the reaction of a rotor that is constant in the tool's.


@dataclass(frozen=True)
class BaseForce(PointEffect):
    """A force that keeps its size and direction in base axes, whatever the tool's orientation.

    force_x, force_y, force_z in N along the world's axes, positive towards them, on the tool: the weight of a hose that
    is carried elsewhere, a balancer's pull, a steady stream of air. The point r is at the distance d (m) along the tip;
    in six axes it is (x, y, d) in the sensor frame. The torque about the sensor is r x F, in six axes plus torque_x,
    torque_y, torque_z (N m, world axes): a zero that a controller has taken in base axes is such a force, with d = 0,
    and torque. In the plane such a torque is in the bias. With `on_axis`, x, y and the torque are fixed at 0.

    At rest the vertical force is weight, the horizontal one that of a tilted base: only accelerations tell them apart,
    and the torque, where the force is not at the centre of mass. With `horizontal` the vertical force is fixed at 0, as
    a diagnosis of poses at rest has it: mass and centre of mass are then those of the weight and that force together.
    """

    horizontal: bool = False

    id = "base_force"
    title = "force that is constant in base axes"
    stage = Stage.TIP_BODY
    equation = "F = R' force, T = r x F + R' torque, R from sensor to base axes"
    advice = (
        "look for a hose or a cable whose weight the tool carries, and for a balancer; zero the sensor in its own "
        "axes, not while its readings are shown in base axes"
    )
    confused_with = (
        "gravity_tilt, of its horizontal part; the tool's mass, of its vertical part in slow motion; a payload that a "
        "controller subtracts, of an upward force; cable_spring with a distant anchor"
    )
    shows = "A force of constant size that turns in the sensor as gravity does, but does not grow with acceleration."
    provoked_by = "Static poses in many orientations, and one fast motion, which tells the force from a weight."
    amounts: ClassVar[Mapping[str, float]] = {"N": 1.5, "N m": 0.08, **POINT_AMOUNTS}
    sketch = (
        Tool(turn=-28),
        Circle(162, 106, 3, "accent dot"),
        Arrow((162, 106), (204, 132)),
        Name(150, 128, "force", "end"),
        Arrow((30, 126), (30, 96), "faint"),
        Arrow((30, 126), (60, 126), "faint"),
        Text(34, 142, "base"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Force in N, the point in m, in six axes torque in N m."""
        force = tuple(
            Parameter(
                name=f"force_{axis}",
                unit="N",
                meaning=f"component of the force along the world's {axis} axis",
                bounds=(0.0, 0.0) if self.horizontal and axis == space.axes[-1] else (-inf, inf),
            )
            for axis in space.axes
        )
        torque = tuple(
            Parameter(
                name=f"torque_{axis}",
                unit="N m",
                meaning=f"torque beside that of the force, about the world's {axis} axis",
                bounds=(0.0, 0.0) if self.on_axis else (-inf, inf),
            )
            for axis in (space.axes if space is Space.SPACE else ())
        )
        return (*force, *self.point_parameters(space), *torque)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the force and the torque to the tool."""
        force, torque = (
            world_vector(chain.space, *(p.get(f"{kind}_{axis}", 0) for axis in chain.space.axes))
            for kind in ("force", "torque")
        )
        to_tool = chain.motion.rotation.T
        pulled = with_force(chain, to_tool * force, point_of_application(chain, p))
        return replace(pulled, torque=pulled.torque + to_tool * torque)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Points along the tip."""
        return tuple({"d": d} for d in tip_distances(domain))

    def at_rest(self) -> Self:
        """Without its vertical component, which is weight."""
        return replace(self, horizontal=True)


@dataclass(frozen=True)
class SpinningRotor(Effect):
    """A rotor on the tool turns the torque of its angular momentum h: T = -omega x h on the tool (N m).

    h (N m s, sensor frame, right-handed about its axes) is the rotor's inertia times its speed relative to the tool,
    and constant: a spindle, a fan, the motor of a gripper. omega is the tool's angular velocity in the world. The
    sensor exerts omega x h, by which h turns with the tool. In the plane no rotor shows: T has no component about the
    normal.
    """

    id = "spinning_rotor"
    title = "reaction of a spinning rotor"
    stage = Stage.TIP_BODY
    equation = "T = -omega x h"
    advice = "stop the spindle, fan or motor on the tool and record the same motion again"
    confused_with = "the products of inertia, in rotation about one axis; sensor_crosstalk, in slow motion"
    shows = "A torque across the angular velocity and in proportion to it, that does no work; no force."
    provoked_by = "Fast rotation about two axes across the rotor's, with the rotor on and off."
    amounts: ClassVar[Mapping[str, float]] = {"N m s": 0.05}
    spaces = (Space.SPACE,)
    sketch = (
        Tool(),
        Box(98, 62, 44, 24, "accent"),
        Arrow((120, 74), (186, 74)),
        Name(152, 66, "h_x, h_y, h_z"),
        Arc(120, 28, 108, 96, 124, "ink"),
        Arrow((62, 119), (56, 115), "ink"),
        Text(50, 134, "ω", "end"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Angular momentum in N m s."""
        meaning = "angular momentum of the rotor along the sensor's {} axis"
        return tuple(Parameter(name=f"h_{axis}", unit="N m s", meaning=meaning.format(axis)) for axis in space.axes)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the rotor's reaction to the tool."""
        momentum = vector(*(p[f"h_{axis}"] for axis in chain.space.axes))
        return replace(chain, torque=chain.torque - chain.motion.omega.cross(momentum))
