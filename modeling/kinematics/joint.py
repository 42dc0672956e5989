"""Joints of a serial arm and their placements on the preceding link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot, inf, isfinite
from typing import Any

from modeling.kinematics.quaternion import quaternion_product, rotated_vector

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

LARGEST_NUMBER = 1e12  # beyond any length, speed or force that a rig has
SMALLEST_NUMBER = 1e-12  # below any that a rig states; its square can still be divided by
UNIT_NORM_TOLERANCE = 1e-9  # deviation of a norm from 1 after seven quaternion products and a round trip through a file


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


def translated(p: Sequence[Any], by: Sequence[Any]) -> tuple[Any, ...]:
    """The point p + by, numbers or CasADi expressions."""
    return tuple(a + b for a, b in zip(p, by, strict=True))
