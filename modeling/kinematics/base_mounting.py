"""Mounting of a robot's base: from base axes to the world, whose last axis points up, by the direction of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, cos, hypot, sin
from typing import Any

from modeling.kinematics.joint import LARGEST_NUMBER, SMALLEST_NUMBER, Placement, Quaternion
from modeling.kinematics.quaternion import quaternion_product, rotated_vector

Direction = tuple[float, ...]
"""Unit vector along gravity in base axes: x, y in the plane, x, y, z in six axes."""

SPATIAL_VECTORS = ("p", "vp", "ap")
PLANAR_VECTORS = ("p", "v", "a")


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
    found, c, s = dict(motion), cos(angle), sin(angle)
    if "phi" in found:
        found["phi"] = found["phi"] + angle
    for prefix in PLANAR_VECTORS:
        x, y = prefix + "x", prefix + "y"
        if x in motion and y in motion:
            found |= {x: c * motion[x] + s * motion[y], y: c * motion[y] - s * motion[x]}
    return found


def _spatial(motion: Mapping[str, Any], direction: Direction) -> dict[str, Any]:
    found, turn = dict(motion), base_placement(direction).quaternion
    vectors = [[prefix + axis for axis in "xyz"] for prefix in SPATIAL_VECTORS]
    orientation = ["qx", "qy", "qz", "qw"]
    if motion.keys() >= set(orientation):
        turned = quaternion_product(turn, [motion[name] for name in orientation])
        found |= dict(zip(orientation, turned, strict=True))
    for names in vectors:
        if motion.keys() >= set(names):
            found |= dict(zip(names, rotated_vector(turn, [motion[name] for name in names]), strict=True))
    return found
