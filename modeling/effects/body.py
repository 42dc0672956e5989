"""Effects on the tool itself: where its mass is, which way is down, what drags and pulls at it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import hypot, inf, pi

import numpy as np
import sympy as sp

from modeling.chain import Chain, Stage, in_plane, point_on_tip, velocity_on_tip
from modeling.effect import Effect, Extent, Values
from modeling.parameter import Parameter
from modeling.space import Space, turned, vector
from modeling.tip import Body

SLOWEST = 1e-6
"""Speed (m/s) below which |v| is rounded off, so that it has a derivative at rest."""

CELL = (-5.0, 5.0)
"""Where a tether can be tied (m, each world axis): in the robot's cell. From farther away it is a constant force."""

DISTANCE = Parameter(name="d", unit="m", bounds=(-0.5, 1.5), nuisance=True)


def pushed(chain: Chain, force: sp.Matrix, distance: sp.Expr) -> Chain:
    """The chain with `force` (N, sensor frame, on the tool) acting at `distance` along the tip."""
    torque = point_on_tip(chain, distance).cross(force)
    return replace(chain, force=chain.force + force, torque=chain.torque + torque)


def distances(extent: Extent) -> list[float]:
    """Where along the tip a force may act, m."""
    return [float(d) for d in np.linspace(0.0, extent.reach, 5)]


@dataclass(frozen=True)
class CentreOfMassOffset(Effect):
    """The tool's centre of mass lies off the tip axis.

    The first moment becomes (mlx, -mlg, 0) in the axes (x', -y'): positive mlx (kg m) lies along +x'. It adds
    mlx·ddphi to the force along -y', mlx·dphi² along -x', and mlx times the lift along -y' to the torque.
    """

    id = "com_offset"
    title = "centre of mass off the tip axis"
    stage = Stage.TIP_BODY
    equation = "c = mlg y' + mlx x'"
    advice = "take poses at rest: the torque follows the direction of gravity; look for a gripper mounted off axis"
    spaces = (Space.PLANE,)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mlx in kg m."""
        return (Parameter(name="mlx", unit="kg m"),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Shift the first moment along x'."""
        body = chain.body
        return replace(chain, body=Body(body.mass, body.first_moment + vector(p["mlx"], 0, 0), body.inertia))


@dataclass(frozen=True)
class GravityTilt(Effect):
    """The base is not level: gravity is turned against the world that the motion is given in.

    In the plane g becomes g (-sin angle, -cos angle): positive angle (rad) turns it clockwise. In six axes it is
    turned about the world's x and y by tilt_x, tilt_y (rad), right-handed.
    """

    id = "gravity_tilt"
    title = "base not level"
    stage = Stage.TIP_BODY
    equation = "g -> R(angle) g"
    advice = "put a level on the robot's base; compare with the mounting that the controller assumes"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, two in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("tilt_x", "tilt_y")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi / 4, pi / 4)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Turn the gravity vector."""
        if chain.space is Space.PLANE:
            turn = turned(chain.space, (-p["angle"],))
        else:
            turn = turned(chain.space, (p["tilt_x"], p["tilt_y"], sp.S.Zero))
        return replace(chain, gravity=turn * chain.gravity)


@dataclass(frozen=True)
class ViscousDrag(Effect):
    """A force against the velocity of the point at distance d along the tip: F = -c v (on the tool, N).

    c in N s/m is positive (it takes energy away), d in m; the torque about the sensor is r x F.
    """

    id = "viscous_drag"
    title = "drag proportional to speed"
    stage = Stage.TIP_BODY
    equation = "F = -c v(d)"
    advice = "run the same path at half and double speed; look for a hose, a brush or a fluid that the tool moves in"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s/m, d in m."""
        return (Parameter(name="c", unit="N s/m", bounds=(0.0, inf)), DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool against its velocity."""
        return pushed(chain, -p["c"] * velocity_on_tip(chain, p["d"]), p["d"])

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Points along the tip."""
        return tuple({"d": d} for d in distances(extent))


@dataclass(frozen=True)
class QuadraticDrag(ViscousDrag):
    """A force against the velocity of the point at distance d, growing with its square: F = -c |v| v (N).

    c in N s²/m² is positive, d in m; |v| is rounded off below 1e-6 m/s.
    """

    id = "quadratic_drag"
    title = "drag proportional to speed squared"
    equation = "F = -c |v(d)| v(d)"
    advice = "run the same path at half and double speed: a quarter and four times the force; look for a large plate"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s²/m², d in m."""
        return (Parameter(name="c", unit="N s²/m²", bounds=(0.0, inf)), DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool against its velocity times its speed."""
        velocity = velocity_on_tip(chain, p["d"])
        speed = sp.sqrt(velocity.dot(velocity) + SLOWEST**2)
        return pushed(chain, -p["c"] * speed * velocity, p["d"])


@dataclass(frozen=True)
class CableSpring(Effect):
    """A tether pulls the point at d along the tip towards an anchor, and never pushes.

    With u the vector from the point to the anchor (world, m), F = k max(0, |u| - length) u/|u|: k in N/m,
    length (m) is where it goes taut.
    """

    id = "cable_spring"
    title = "tether or cable pulling at the tool"
    stage = Stage.TIP_BODY
    equation = "F = k max(0, |u| - length) u/|u|, u = anchor - point(d)"
    advice = "look for a cable or hose that goes taut in part of the workspace; free it and record again"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """k in N/m; anchor, length and d in m."""
        anchor = tuple(Parameter(name=f"anchor_{a}", unit="m", bounds=CELL, nuisance=True) for a in space.axes)
        length = Parameter(name="length", unit="m", bounds=(0.0, inf), nuisance=True)
        return (Parameter(name="k", unit="N/m", bounds=(0.0, inf)), *anchor, length, DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Pull the tool towards the anchor."""
        anchor = in_plane(chain.space, *(p[f"anchor_{a}"] for a in chain.space.axes))
        motion = chain.motion
        to_anchor = motion.rotation.T * (anchor - motion.position) - point_on_tip(chain, p["d"])
        distance = sp.sqrt(to_anchor.dot(to_anchor) + SLOWEST**2)
        stretch = sp.Max(0, distance - p["length"])
        return pushed(chain, p["k"] * stretch / distance * to_anchor, p["d"])

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Anchors in and around the box that was visited, for cables always taut and taut in a part of it."""
        if not extent.low:
            return ()
        low, high = np.array(extent.low), np.array(extent.high)
        margin = np.maximum(high - low, 0.3) * 1.5
        count = 8 if len(low) == 2 else 5
        lines = [np.linspace(a, b, count) for a, b in zip(low - margin, high + margin, strict=True)]
        names = [f"anchor_{a}" for a in "xyz"[: len(low)]]
        return tuple(
            dict(zip(names, map(float, anchor), strict=True)) | {"length": length, "d": d}
            for anchor in product(*lines)
            for length in _slack_lengths(np.array(anchor), low, high)
            for d in (0.0, 0.5 * extent.reach, extent.reach)
        )


def _slack_lengths(anchor: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[float]:
    """Natural lengths between zero and the farthest corner of the box from the anchor."""
    corners = [hypot(*(np.array(corner) - anchor)) for corner in product(*zip(low, high, strict=True))]
    nearest, farthest = min(corners), max(corners)
    return [0.0, nearest + 0.25 * (farthest - nearest), nearest + 0.6 * (farthest - nearest)]
