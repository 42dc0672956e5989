"""Loads on the tool: cable, drag and friction, payload changes and contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, product
from math import dist, inf
from typing import Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, velocity_of_point, world_vector
from modeling.chain.effect import Effect, GridSuperposition, NuisanceValues, SearchDomain
from modeling.parameter import Parameter, Role
from modeling.rigid_body import RigidBody, contact_components, contact_force_torque
from modeling.space import Space, signals, vector

# Effects that act at a point of the tool, and a force of the environment there.


SMOOTHING_SPEED = 1e-6
"""Speed (m/s) or length (m) below which |v| is smoothed, so that it has a derivative at zero."""

TIP_DISTANCE = Parameter(name="d", unit="m", bounds=(-0.5, 1.5), role=Role.SHAPE)
OFFSETS = tuple(Parameter(name=name, unit="m", bounds=(-0.5, 0.5), role=Role.SHAPE) for name in ("x", "y"))
"""Position beside the tip axis, along the sensor's x and y axes: as far as a tool reaches."""
ON_AXIS = tuple(replace(p, bounds=(0.0, 0.0)) for p in OFFSETS)


@dataclass(frozen=True)
class PointEffect(Effect):
    """An effect that acts at a point of the tool: at d along the tip in the plane, at (x, y, d) in six axes.

    With `on_axis`, x and y are fixed at 0 in six axes, too; in the plane it has no meaning. A diagnosis searches on the
    axis: there an effect has the forces that it has 3 cm beside it, nearly, and a test of one amplitude needs less of
    it than one of three. x and y are then tested given all others.
    """

    on_axis: bool = False

    def point_parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coordinates of the point in the sensor frame, m: d in the plane; x, y, d in six axes."""
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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s/m, the point in m."""
        return (Parameter(name="c", unit="N s/m", bounds=(0.0, inf)), *self.point_parameters(space))

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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s²/m², the point in m."""
        return (Parameter(name="c", unit="N s²/m²", bounds=(0.0, inf)), *self.point_parameters(space))

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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N m."""
        return (Parameter(name="level", unit="N m", bounds=(0.0, inf)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the friction torque to the tool."""
        omega = chain.motion.omega
        direction = omega / sp.sqrt(omega.dot(omega) + SMOOTHING_RATE**2)
        return replace(chain, torque=chain.torque - p["level"] * direction)


# Transient events: payload changes and contacts at unknown times.


RAMP_TIME = Fraction(1, 100)
"""Rise and fall time (s) of an event, so that the reading is differentiable in its onset and end."""
NO_END = 1e9
"""End time (s) beyond any recording."""


@dataclass(frozen=True)
class PayloadChange(PointEffect):
    """A point mass is added to the tool at an onset time; it is negative when the mass is removed.

    mass in kg, time in s. The point r is at the distance d (m) along the tip; in six axes it is (x, y, d) in the sensor
    frame. mass adds to m, mass r to the first moment and mass (r·r - r r') to the inertia about the sensor. The ramp
    takes 10 ms.
    """

    id = "payload_change"
    title = "payload picked up or released"
    stage = Stage.TIP_BODY
    equation = "m += mass, c += mass r, I += mass (r·r - r r') for time > time_0"
    advice = "check what the gripper did at that time; identify the tool before and after separately"
    confused_with = "a sustained push along gravity (contact_event); fast bias_drift"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mass in kg, the point in m, time in s."""
        return (
            Parameter(name="mass", unit="kg"),
            *self.point_parameters(space),
            Parameter(name="time", unit="s", role=Role.ONSET),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the mass to the tool."""
        (time,) = signals("time")
        mass, r = p["mass"] * ramp(time - p["time"]), point_of_application(chain, p)
        inertia = mass * (r.dot(r) * sp.eye(3) - r * r.T)
        body = chain.body
        heavier = RigidBody(body.mass + mass, body.first_moment + mass * r, body.inertia + inertia)
        return replace(chain, body=heavier)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Edges of the detected events and 31 times over the recording, each at three points of the tip."""
        import numpy as np

        edges = [edge for event in domain.events for edge in event]
        times = [*edges, *map(float, np.linspace(domain.start, domain.end, 33)[1:-1])]
        return tuple({"d": d, "time": t} for t, d in product(times, (0.0, 0.5 * domain.reach, domain.reach)))


@dataclass(frozen=True)
class ContactEvent(Effect):
    """A constant contact wrench on the tool between start and end (s).

    The wrench is the environment's on the tool: along x' and y' and clockwise about the sensor in the plane, in the
    sensor frame in six axes. It rises and falls within 10 ms, so that the reading is differentiable in the times.
    """

    id = "contact_event"
    title = "contact wrench during an interval"
    stage = Stage.TIP_BODY
    equation = "F += Fc, T += Tc for start < time < end"
    advice = "check what touched the tool at that time; exclude the interval from the identification"
    confused_with = "payload_change, if the tool hardly rotates; bias_drift, if the push is slow"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """start and end in s, then the wrench in N and N m."""
        times = tuple(Parameter(name=name, unit="s", role=Role.ONSET) for name in ("start", "end"))
        return times + tuple(
            Parameter(name=n, unit=u) for n, u in zip(contact_components(space), space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the contact wrench during the interval."""
        (time,) = signals("time")
        during = sp.Min(ramp(time - p["start"]), ramp(p["end"] - time))
        force, torque = contact_force_torque(chain.space, [p[name] for name in contact_components(chain.space)])
        return replace(chain, force=chain.force + during * force, torque=chain.torque + during * torque)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Intervals of detected events, and those between the points of a grid of 17 times over the recording."""
        import numpy as np

        times = np.linspace(domain.start, domain.end, 17)
        windows = [*domain.events, *combinations(map(float, times), 2)]
        return tuple({"start": start, "end": end} for start, end in windows)

    def combination(self, points: Sequence[NuisanceValues]) -> GridSuperposition:
        """A pulse of at least the rise time is the difference of two steps, one at its start and one at its end.

        min(ramp(t - start), ramp(end - t)) = ramp(t - start) + ramp(end - t) - 1 if end - start >= `RAMP_TIME`, and
        ramp(end - t) = 1 - ramp(t - end).
        """
        whole = [v["end"] - v["start"] >= float(RAMP_TIME) for v in points]
        starts = sorted({t for v, w in zip(points, whole, strict=True) if w for t in (v["start"], v["end"])})
        place = {t: i for i, t in enumerate(starts)}
        blocks: list[NuisanceValues] = [{"start": t, "end": NO_END} for t in starts]
        index, weights = [], []
        for values, combined in zip(points, whole, strict=True):
            if combined:
                index.append((place[values["start"]], place[values["end"]]))
                weights.append((1.0, -1.0))
            else:
                index.append((len(blocks), len(blocks)))
                weights.append((1.0, 0.0))
                blocks.append(values)
        return GridSuperposition(blocks=tuple(blocks), index=tuple(index), weights=tuple(weights))


def ramp(elapsed: sp.Expr) -> sp.Expr:
    """Step from 0 to 1 at `elapsed` (s) = 0, linear within `RAMP_TIME`."""
    return sp.Min(1, sp.Max(0, elapsed / RAMP_TIME + sp.Rational(1, 2)))


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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """k in N/m; anchor, length and the point in m."""
        anchor = tuple(
            Parameter(name=f"anchor_{a}", unit="m", bounds=ANCHOR_BOUNDS, role=Role.SHAPE) for a in space.axes
        )
        length = Parameter(name="length", unit="m", bounds=(0.0, inf), role=Role.SHAPE)
        return (Parameter(name="k", unit="N/m", bounds=(0.0, inf)), *anchor, length, *self.point_parameters(space))

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
