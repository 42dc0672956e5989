"""Joint: what moves between two links of an arm, and where it stands on the link before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot, inf, isfinite
from typing import Any

from modeling.quaternion import product, rotated

Vector = tuple[float, float, float]
Four = tuple[float, float, float, float]

LARGEST = 1e12  # beyond any length, speed or force that a rig has
ROUNDING = 1e-9  # of the norm of what was normalised, through seven products and a file


def _require_unit(name: str, values: tuple[float, ...]) -> None:
    if not abs(hypot(*values) - 1.0) < ROUNDING:
        raise ValueError(f"a unit {name} was expected, and {list(values)} came")


@dataclass(frozen=True, kw_only=True)
class Placement:
    """A frame as seen from another: origin (m) and unit quaternion x y z w, v_other = R(quaternion) v_own.

    Raises ValueError for a quaternion that is not a unit one, or a position that is not finite.
    """

    position: Vector = (0.0, 0.0, 0.0)
    quaternion: Four = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _require_unit("quaternion", self.quaternion)
        if not all(map(isfinite, self.position)):
            raise ValueError(f"a finite position was expected, and {list(self.position)} came")

    def then(self, other: Placement) -> Placement:
        """The frame that `other` is as seen from this one, as seen from where this one is."""
        x, y, z = moved(self.position, rotated(self.quaternion, other.position))
        i, j, k, w = product(self.quaternion, other.quaternion)
        return Placement(position=(x, y, z), quaternion=(i, j, k, w))


UNMOVED = Placement()


class JointKind(Enum):
    """How a joint moves: about its axis by an angle (rad), or along it by a length (m)."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One coordinate of an arm.

    placement   of the joint at coordinate zero, on the frame of the joint before it
    axis        unit vector in its own frame
    position    lowest and highest coordinate, rad or m; None where nothing bounds it
    velocity    lowest and highest rate, rad/s or m/s; None where nothing bounds it

    Raises ValueError for an axis that is not a unit vector, or limits that are no interval.
    """

    name: str
    kind: JointKind
    placement: Placement
    axis: Vector
    position: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _require_unit("axis", self.axis)
        for name, pair in (("position", self.position), ("velocity", self.velocity)):
            if pair is not None and not -inf < pair[0] < pair[1] < inf:
                raise ValueError(f"{name} low below high was expected, and {list(pair)} came")


def moved(p: Sequence[Any], by: Sequence[Any]) -> tuple[Any, ...]:
    """The point p + by, numbers or CasADi expressions."""
    return tuple(a + b for a, b in zip(p, by, strict=True))
