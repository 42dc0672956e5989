"""Spatial arm of revolute and prismatic joints: motion of the force sensor from the joint coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from modeling.kinematics.arm import Arm, ArmFrames, MathBackend
from modeling.kinematics.base_mounting import Direction, base_placement
from modeling.kinematics.joint import IDENTITY_PLACEMENT, Joint, JointKind, Placement, translated
from modeling.kinematics.quaternion import COMPONENTS, quaternion_conjugate, quaternion_product, rotated_vector
from modeling.space import Space

Array = NDArray[np.float64]

VECTORS = tuple(prefix + axis for prefix in ("w", "al", "p", "vp", "ap") for axis in "xyz")


@dataclass(frozen=True)
class SpatialArm(Arm):
    """Serial arm of revolute and prismatic joints from the world, z up, to the sensor frame.

    `sensor` is the placement of the sensor in the frame moved by the last joint.
    """

    chain: tuple[Joint, ...]
    sensor: Placement = IDENTITY_PLACEMENT

    space: ClassVar[Space] = Space.SPACE
    names: ClassVar[tuple[str, ...]] = COMPONENTS + VECTORS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.chain)

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        """The kind of each joint of the chain."""
        return tuple(joint.kind for joint in self.chain)

    def mounted(self, direction: Direction) -> Self:
        """The first joint's placement, or of an arm without joints the sensor's, turned with the base."""
        base = base_placement(direction)
        if not self.chain:
            return replace(self, sensor=base.then(self.sensor))
        first = replace(self.chain[0], placement=base.then(self.chain[0].placement))
        return replace(self, chain=(first, *self.chain[1:]))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """Forward kinematics along the chain.

        The error of a joint lengthens the offset from it to the next joint, or to the sensor, in its own direction.
        """
        s, p = IDENTITY_PLACEMENT.quaternion, IDENTITY_PLACEMENT.position
        origins, axes = [], []
        longer: list[Any] = [0.0, *errors]
        for joint, coordinate, error in zip(self.chain, q, longer[:-1], strict=True):
            p = _named(calculus, translated(p, rotated_vector(s, _lengthened(joint.placement.position, error))))
            s = _named(calculus, quaternion_product(s, joint.placement.quaternion))
            axis = _named(calculus, rotated_vector(s, joint.axis))
            origins.append(p)
            axes.append(axis)
            if joint.kind is JointKind.PRISMATIC:
                p = _named(calculus, translated(p, [coordinate * c for c in axis]))
            else:
                half = calculus.let(coordinate / 2)
                turn = (*(c * calculus.sin(half) for c in joint.axis), calculus.cos(half))
                s = _named(calculus, quaternion_product(s, _named(calculus, turn)))
        p = _named(calculus, translated(p, rotated_vector(s, _lengthened(self.sensor.position, longer[-1]))))
        s = _named(calculus, quaternion_product(s, self.sensor.quaternion))
        return ArmFrames(tuple(origins), tuple(axes), (*s, *p))

    def signals(self, pose: Sequence[Any], first: Sequence[Any], second: Sequence[Any]) -> dict[str, Any]:
        """qx .. qw (sensor in the world), wx .. and alx .. (rad/s, rad/s², sensor frame), px .., vpx .., apx ..

        p is the sensor origin in the world (m; kinematic accelerations). From the unit quaternion s, in the sensor
        frame, omega = 2 vec(conj(s) ⊗ ds/dt); its derivative in time is alpha = 2 vec(conj(s) ⊗ d²s/dt²), since
        conj(ds/dt) ⊗ ds/dt is a scalar. All signals are continuous in q: s is a polynomial in sines and cosines of half
        angles.
        """
        s, ds, dds = pose[:4], first[:4], second[:4]
        omega, alpha = ([2 * c for c in quaternion_product(quaternion_conjugate(s), rate)[:3]] for rate in (ds, dds))
        return dict(zip(self.names, (*s, *omega, *alpha, *pose[4:], *first[4:], *second[4:]), strict=True))

    @property
    def position_limits(self) -> Array:
        """Lowest and highest coordinate of each joint (n, 2), rad or m; infinite when unbounded."""
        return np.array([j.position or (-np.inf, np.inf) for j in self.chain])


def _lengthened(offset: Sequence[float], error: Any) -> tuple[Any, ...]:
    """An offset vector (m), longer by `error` (m) in its own direction; a zero vector is unchanged."""
    length = hypot(*offset)
    return tuple(offset) if length == 0 else tuple(part + error * (part / length) for part in offset)


def _named(calculus: MathBackend, parts: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(calculus.let(part) for part in parts)
