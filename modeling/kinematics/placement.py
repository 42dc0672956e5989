"""Placements: quaternions, joints on the preceding link, and the mounting of a robot's base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import atan2, cos, hypot, inf, isfinite, sin
from typing import Any

from modeling import symbolic as sp
from modeling.space import Space, signals

# Quaternion algebra; orientation, angular velocity and acceleration from unnormalised components.


COMPONENTS = ("qx", "qy", "qz", "qw")


def quaternion_product(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, ...]:
    """Hamilton's product a ⊗ b of four components each, x y z w: numbers, SymPy or CasADi expressions."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def quaternion_conjugate(a: Sequence[Any]) -> tuple[Any, ...]:
    """The conjugate: inverse rotation of a unit quaternion."""
    x, y, z, w = a
    return (-x, -y, -z, w)


def rotated_vector(a: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """The vector v (3) rotated by the unit quaternion a: the vector part of a ⊗ (v, 0) ⊗ conj(a)."""
    return quaternion_product(quaternion_product(a, (*v, 0.0)), quaternion_conjugate(a))[:3]


def angular_motion(components: Sequence[Sequence[sp.Symbol]]) -> Mapping[str, sp.Expr]:
    """qx .. qw, wx .. wz (rad/s) and alx .. alz (rad/s²) in the sensor frame, from s, ds, dds of four components each.

    The orientation is R(s / |s|) with the rotation matrix of the model's space; omega is the vector of the
    skew-symmetric matrix R' dR, alpha its time derivative. Changes of |s| have no effect.
    """
    return _angular_motion(tuple(map(tuple, components)))


@lru_cache(maxsize=8)
def _angular_motion(components: tuple[tuple[sp.Symbol, ...], ...]) -> Mapping[str, sp.Expr]:
    s, ds, dds = map(sp.Matrix, components)
    unit = dict(zip(signals(*COMPONENTS), s / sp.sqrt(s.dot(s)), strict=True))
    rotation = Space.SPACE.motion.rotation.xreplace(unit)
    spin = rotation.T * _rate(rotation, (s, ds))
    # Cancelled, as short as 2 vec(conj(s) ds) / |s|²; otherwise the derivative is a thousand times longer.
    omega = sp.Matrix([sp.cancel(entry) for entry in (spin[2, 1], spin[0, 2], spin[1, 0])])
    alpha = _rate(omega, (s, ds), (ds, dds))
    expressions = {symbol.name: value for symbol, value in unit.items()}
    return expressions | {
        p + axis: vector[i] for p, vector in (("w", omega), ("al", alpha)) for i, axis in enumerate("xyz")
    }


def _rate(matrix: sp.Matrix, *pairs: tuple[sp.Matrix, sp.Matrix]) -> sp.Matrix:
    """Time derivative of the matrix, by the chain rule over pairs of (variables, their rates)."""
    terms = [matrix.diff(x) * dx for of, rates in pairs for x, dx in zip(of, rates, strict=True)]
    return sum(terms, sp.zeros(*matrix.shape))


# Joints of a serial arm and their placements on the preceding link.


Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

LARGEST_NUMBER = 1e12
"""Beyond any length, speed or force that a rig has."""
SMALLEST_NUMBER = 1e-12
"""Below any that a rig states; its square can still be divided by."""
UNIT_NORM_TOLERANCE = 1e-9
"""Deviation of a norm from 1 after seven quaternion products and a round trip through a file."""


def _require_unit(name: str, values: tuple[float, ...]) -> None:
    if not abs(hypot(*values) - 1.0) < UNIT_NORM_TOLERANCE:
        raise ValueError(f"expected a unit {name}, got {list(values)}")


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Pose of a frame in another: origin (m) and unit quaternion x y z w, v_other = R(quaternion) v_own.

    Raises ValueError for a quaternion that is not normalised, or a position that is not finite.
    """

    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _require_unit("quaternion", self.quaternion)
        if not all(map(isfinite, self.position)):
            raise ValueError(f"expected a finite position, got {list(self.position)}")

    def then(self, other: Placement) -> Placement:
        """Composition of the two placements: `other` is given in this frame, the result in this frame's parent."""
        x, y, z = translated(self.position, rotated_vector(self.quaternion, other.position))
        i, j, k, w = quaternion_product(self.quaternion, other.quaternion)
        return Placement(position=(x, y, z), quaternion=(i, j, k, w))


IDENTITY_PLACEMENT = Placement()


class JointKind(Enum):
    """Rotation about the axis (rad) or translation along it (m)."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One joint of an arm.

    placement   of the joint at coordinate zero, on the frame of the joint before it
    axis        unit vector in its own frame
    position    lowest and highest coordinate, rad or m; None when unbounded
    velocity    lowest and highest rate, rad/s or m/s; None when unbounded

    Raises ValueError for an axis that is not a unit vector, or limits that are no interval.
    """

    name: str
    kind: JointKind
    placement: Placement
    axis: Vector3
    position: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _require_unit("axis", self.axis)
        for name, pair in (("position", self.position), ("velocity", self.velocity)):
            if pair is not None and not -inf < pair[0] < pair[1] < inf:
                raise ValueError(f"expected {name} low below high, got {list(pair)}")


Inertia = tuple[float, float, float, float, float, float]
"""Ixx, Ixy, Ixz, Iyy, Iyz, Izz, kg m²."""
ROUNDED = 0.01
"""Of half the sum of the moments, what rounding may make impossible: two digits of a thin body's moments may be so."""


def is_possible(inertia: Sequence[float]) -> bool:
    """Whether a body may have this inertia (an `Inertia`) about its centre.

    Its mass is at real distances: the sum of p p' dm, half the trace less the inertia, has no negative eigenvalue. With
    what rounding may do added on its diagonal, its leading minors are positive.
    """
    xx, xy, xz, yy, yz, zz = inertia
    half = (xx + yy + zz) / 2
    a, b, c = (half * (1 + ROUNDED) - moment for moment in (xx, yy, zz))
    det = a * (b * c - yz * yz) - xy * (xy * c + yz * xz) - xz * (xy * yz + b * xz)
    return min(a, a * b - xy * xy, det) >= 0


@dataclass(frozen=True, kw_only=True)
class Body:
    """A rigid body that moves with a link of an arm.

    joint    joints that move it, from the base
    mass     kg
    centre   its centre of mass in the frame that the last of them moves, m
    inertia  about the centre, along that frame's axes
    """

    joint: int
    mass: float
    centre: Vector3
    inertia: Inertia

    def moved(self, frame: Placement, joint: int) -> Body:
        """The same in the frame in which its own has this placement, moved by so many joints."""
        xx, xy, xz, yy, yz, zz = self.inertia
        rows = [rotated_vector(frame.quaternion, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = (
            rotated_vector(frame.quaternion, column) for column in zip(*rows, strict=True)
        )
        x, y, z = translated(frame.position, rotated_vector(frame.quaternion, self.centre))
        return Body(joint=joint, mass=self.mass, centre=(x, y, z), inertia=(xx, xy, xz, yy, yz, zz))


def translated(p: Sequence[Any], by: Sequence[Any]) -> tuple[Any, ...]:
    """The point p + by, numbers or CasADi expressions."""
    return tuple(a + b for a, b in zip(p, by, strict=True))


# Mounting of a robot's base: from base axes to the world, whose last axis points up, by the direction of gravity.


Direction = tuple[float, ...]
"""Unit vector along gravity in base axes: x, y in the plane, x, y, z in six axes."""

SPATIAL_VECTORS = ("p", "vp", "ap")
"""Prefixes of the signals along the axes of the base, in six axes."""
PLANAR_VECTORS = ("p", "v", "a")
"""The same in the plane."""


def unit_direction(components: Sequence[float]) -> Direction:
    """The unit vector of two or three components. Raises ValueError where they are none, or of no plausible size."""
    size = hypot(*components)
    if len(components) not in (2, 3) or not SMALLEST_NUMBER < size < LARGEST_NUMBER:
        raise ValueError("expected the direction of gravity in base axes, such as [0, 0, -1]")
    return tuple(float(c) / size for c in components)


def base_angle(direction: Direction) -> float:
    """Angle (rad, clockwise) by which a planar base is turned in the world, so that gravity points along -y there.

    Rotated clockwise by b, d = (sin b, -cos b) becomes (0, -1).
    """
    return atan2(direction[0], -direction[1])


def base_placement(direction: Direction) -> Placement:
    """Placement of the base in the world, z up: the rotation of least angle that takes `direction` to -z.

    About d x -z by the angle between them; about x where gravity points along +z of the base.
    """
    x, y, z = direction
    across = hypot(x, y)
    if across == 0:
        quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0) if z > 0 else (0.0, 0.0, 0.0, 1.0)
        return Placement(quaternion=quaternion)
    half = atan2(across, -z) / 2
    return Placement(quaternion=(-y / across * sin(half) + 0.0, x / across * sin(half) + 0.0, 0.0, cos(half)))


def in_base_axes(vector: Direction, direction: Direction) -> Direction:
    """A vector of the world in axes of a base in which gravity points along `direction`."""
    if len(direction) == 2:
        c, s = cos(base_angle(direction)), sin(base_angle(direction))
        return (c * vector[0] - s * vector[1], c * vector[1] + s * vector[0])
    x, y, z, w = base_placement(direction).quaternion
    return tuple(rotated_vector((-x, -y, -z, w), vector))


def motion_in_world(motion: Mapping[str, Any], direction: Direction) -> dict[str, Any]:
    """The signals of a sensor's motion in base axes, numbers, arrays or expressions, in the world."""
    return _planar(motion, base_angle(direction)) if len(direction) == 2 else _spatial(motion, direction)


def _planar(motion: Mapping[str, Any], angle: float) -> dict[str, Any]:
    turned, c, s = dict(motion), cos(angle), sin(angle)
    if "phi" in turned:
        turned["phi"] = turned["phi"] + angle
    for prefix in PLANAR_VECTORS:
        x, y = prefix + "x", prefix + "y"
        if x in motion and y in motion:
            turned |= {x: c * motion[x] + s * motion[y], y: c * motion[y] - s * motion[x]}
    return turned


def _spatial(motion: Mapping[str, Any], direction: Direction) -> dict[str, Any]:
    mounted, turn = dict(motion), base_placement(direction).quaternion
    vectors = [[prefix + axis for axis in "xyz"] for prefix in SPATIAL_VECTORS]
    orientation = ["qx", "qy", "qz", "qw"]
    if motion.keys() >= set(orientation):
        turned = quaternion_product(turn, [motion[name] for name in orientation])
        mounted |= dict(zip(orientation, turned, strict=True))
    for names in vectors:
        if motion.keys() >= set(names):
            mounted |= dict(zip(names, rotated_vector(turn, [motion[name] for name in names]), strict=True))
    return mounted
