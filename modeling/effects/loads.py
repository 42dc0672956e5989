"""Loads on the tool (drag, friction, a cable), and the spring and damper that it is mounted on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import dist, inf, sqrt
from typing import ClassVar, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, velocity_of_point, world_vector
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.dynamics.deflection import Deflection
from modeling.parameter import Parameter, Role
from modeling.sketch import Arc, Arrow, Axes, Circle, Length, Line, Name, Sketch, Text, Tool
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


SMOOTHING_RATE = 1e-3
"""Angular velocity (rad/s) below which Coulomb friction is smoothed."""


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
class CoulombFriction(Effect):
    """A torque of constant magnitude against the rotation, T = -level omega/|omega|: a hose or cable rubs at the wrist.

    level in N m is positive, omega is the tool's angular velocity in the world; |omega| is smoothed below 1e-3 rad/s,
    the width of the step at a reversal.
    """

    id = "coulomb_friction"
    title = "Coulomb friction torque against the rotation"
    stage = Stage.TIP_BODY
    equation = "T = -level omega / sqrt(omega² + (0.001 rad/s)²)"
    advice = "look for a hose or cable that rubs at the wrist; reverse slowly and fast: the step has the same height"
    confused_with = "sensor_hysteresis of the torque; viscous_drag, at nearly constant speed"
    shows = "A step in the torque wherever the rotation reverses, of the same height at any speed."
    provoked_by = (
        "Reverse slowly and fast in the same pose: a viscous torque changes with the speed, this one does not."
    )
    amounts: ClassVar[Mapping[str, float]] = {"level": 0.05}
    sketch = (
        Axes("angular velocity", "torque", centred=True),
        Line(((32, 40), (116, 40), (120, 112), (210, 112)), "accent"),
        Length((62, 40), (62, 76), Name(68, 62, "level")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N m."""
        meaning = "size of the torque, whatever the angular velocity"
        return (Parameter(name="level", unit="N m", meaning=meaning, bounds=(0.0, inf)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the friction torque to the tool."""
        omega = chain.motion.omega
        direction = omega / sp.sqrt(omega.dot(omega) + SMOOTHING_RATE**2)
        return replace(chain, torque=chain.torque - p["level"] * direction)


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
