"""Clearances of an arm's capsules: from half-spaces, fixed capsules and one another, between the samples too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from design.trajectories.trajectory import Array, Trajectory
from modeling.errors import InputError
from modeling.kinematics.arm import Arm, SpatialArm
from modeling.kinematics.placement import JointKind, Placement
from modeling.rig import Capsule, HalfSpace, Workspace

Index = NDArray[np.intp]

NEIGHBOURS = 1
"""Joints between links whose capsules may overlap: those of a joint's two links do at the joint."""
POSTURES = 200
"""Random postures within the position limits of which a pair of capsules that overlaps in all is one that cannot part:
left out. One that parts in a twentieth is left out once in 28 000 times."""
MARGIN = 1e-4
"""m: what a clearance between the samples may be stated too small."""
FEWEST_INSTANTS, MOST_INSTANTS = 64, 40_000
"""Instants of the grid that this margin asks for."""
SMALLEST_GAP = 0.2
"""Share of the smallest distance on the grid that has to be left between its instants, for the margin to hold."""


@dataclass(frozen=True, eq=False)
class ArmPlaces:
    """Places (N, n + 1, 3) and axes as columns (N, n + 1, 3, 3) of the base and of each joint's moving frame, in the
    world; m."""

    origins: Array
    axes: Array
    directions: Array
    revolute: NDArray[np.bool_]

    @classmethod
    def of(cls, arm: SpatialArm, q: Array) -> ArmPlaces:
        """At positions (N, n)."""
        count = len(q)
        origin, axes = np.zeros((count, 3)), np.broadcast_to(np.eye(3), (count, 3, 3))
        origins, turned, directions = [origin], [axes], []
        for joint, coordinate in zip(arm.chain, q.T, strict=True):
            origin = origin + axes @ np.array(joint.placement.position)
            axes = axes @ _rotation(joint.placement)
            along = np.array(joint.axis)
            directions.append(axes @ along)
            if joint.kind is JointKind.PRISMATIC:
                origin = origin + coordinate[:, None] * directions[-1]
            else:
                axes = axes @ _turns(along, coordinate)
            origins.append(origin)
            turned.append(axes)
        revolute = np.array([joint.kind is not JointKind.PRISMATIC for joint in arm.chain])
        return cls(np.stack(origins, 1), np.stack(turned, 1), np.stack(directions, 1), revolute)

    def points(self, joint: Index, own: Array) -> Array:
        """(N, P, 3): points `own` (P, 3) of the frames moved by so many joints (P,), in the world."""
        return np.asarray(self.origins[:, joint] + np.einsum("npij,pj->npi", self.axes[:, joint], own))

    def slopes(self, joint: Index, points: Array) -> Array:
        """(N, P, 3, n): the derivative of points (N, P, 3), each moved by so many joints, by the positions."""
        lever = points[:, :, None] - self.origins[:, None, 1:]
        turning = np.cross(self.directions[:, None], lever)
        moved = np.where(self.revolute[:, None], turning, self.directions[:, None])
        moved = moved * (np.arange(moved.shape[2]) < joint[:, None])[None, :, :, None]
        return np.asarray(np.swapaxes(moved, 2, 3))


def _rotation(placement: Placement) -> Array:
    x, y, z, w = placement.quaternion
    vector = np.array([x, y, z])
    across = np.cross(np.eye(3), vector)
    return np.asarray(np.eye(3) + 2 * w * across + 2 * across @ across)


def _turns(axis: Array, angle: Array) -> Array:
    """(N, 3, 3): rotations about a unit axis by angles (N,), by Rodrigues' formula."""
    across = np.cross(np.eye(3), axis)  # across v = axis x v
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sin * across + (1 - cos) * (across @ across))


@dataclass(frozen=True, eq=False)
class Clearances:
    """Clearances (S,) of an arm's capsules at positions of its joints, m.

    Of each end of a moving capsule from each half-space, then of pairs of capsules: less the radii and the clearance
    that is asked for, so that zero and more is allowed. `strokes` is how far all prismatic joints together may slide.
    """

    arm: SpatialArm
    capsules: tuple[Capsule, ...]
    half_spaces: tuple[HalfSpace, ...]
    pairs: tuple[tuple[int, int], ...]
    clearance: float
    strokes: float = 0.0

    @cached_property
    def _ends(self) -> tuple[Index, Array]:
        """Joints that move each capsule's two ends (2 C,), and the ends (2 C, 3) in the frame that they move."""
        joints = np.repeat([capsule.joint for capsule in self.capsules], 2).astype(np.intp)
        return joints, np.array([end for capsule in self.capsules for end in (capsule.start, capsule.end)], dtype=float)

    @cached_property
    def _near(self) -> Index:
        """Ends (E,) that are kept from half-spaces: those that move, one of a ball."""
        ends = [[2 * i] if c.start == c.end else [2 * i, 2 * i + 1] for i, c in enumerate(self.capsules) if c.joint]
        return np.array([end for both in ends for end in both], dtype=np.intp)

    @cached_property
    def _planes(self) -> tuple[Array, Array]:
        """Normals (H, 3), and by end and half-space (E, H) what is to be taken from n.p."""
        normals = np.array([half.normal for half in self.half_spaces], dtype=float).reshape(-1, 3)
        room = np.array([half.clearance - half.offset for half in self.half_spaces])
        radius = np.array([self.capsules[end // 2].radius for end in self._near])
        return normals, radius[:, None] + room

    @cached_property
    def _apart(self) -> tuple[Index, Index, Array]:
        """The capsules of each pair (P,), (P,), and what is to be taken from their distance (P,)."""
        one, other = np.array(self.pairs, dtype=np.intp).reshape(-1, 2).T
        radius = np.array([capsule.radius for capsule in self.capsules])
        return one, other, radius[one] + radius[other] + self.clearance

    @property
    def names(self) -> list[str]:
        """What each of them is of."""
        named = [self.capsules[end // 2].name for end in self._near]
        of_planes = [f"{name} to half-space {h + 1}" for name in named for h in range(len(self.half_spaces))]
        return of_planes + [f"{self.capsules[i].name} to {self.capsules[j].name}" for i, j in self.pairs]

    @property
    def largest(self) -> float:
        """m: more than any of them can be by a motion whose prismatic joints stay within their strokes, or a metre."""
        joints, ends = self._ends
        reach = float(self._reach(joints).max() + np.linalg.norm(ends, axis=1).max()) + max(1.0, self.strokes)
        return 2 * reach + max((abs(half.offset) for half in self.half_spaces), default=0.0)

    def values(self, q: Array) -> Array:
        """(N, S) at positions (N, n)."""
        places = ArmPlaces.of(self.arm, q)
        points = places.points(*self._ends)
        normals, taken = self._planes
        planes = points[:, self._near] @ normals.T - taken
        distance = np.linalg.norm(self._between(points)[0], axis=-1) - self._apart[2]
        return np.hstack([planes.reshape(len(q), -1), distance])

    def slopes(self, q: Array) -> Array:
        """(N, S, n) at positions (N, n)."""
        places, (joints, _) = ArmPlaces.of(self.arm, q), self._ends
        points = places.points(*self._ends)
        normals, _ = self._planes
        moved = places.slopes(joints[self._near], points[:, self._near])
        planes = np.einsum("hi,npij->nphj", normals, moved).reshape(len(q), -1, q.shape[1])
        between, first, second = self._between(points)
        one, other, _ = self._apart
        relative = places.slopes(joints[2 * one], first) - places.slopes(joints[2 * other], second)
        away = between / np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), np.finfo(float).tiny)
        return np.concatenate([planes, np.einsum("npi,npij->npj", away, relative)], axis=1)

    def _between(self, points: Array) -> tuple[Array, Array, Array]:
        """From the second capsule's axis to the first's, shortest (N, P, 3), and its ends on both axes."""
        one, other, _ = self._apart
        a, b = points[:, 2 * one], points[:, 2 * other]
        s, t = nearest_on_segments(a, points[:, 2 * one + 1] - a, b, points[:, 2 * other + 1] - b)
        first = a + s[..., None] * (points[:, 2 * one + 1] - a)
        second = b + t[..., None] * (points[:, 2 * other + 1] - b)
        return first - second, first, second

    def nearest(self, q: Array, which: int) -> Array:
        """(2, 3): between which points one is at positions (n,), on axes of capsules or a half-space's plane, m."""
        points = ArmPlaces.of(self.arm, q[None]).points(*self._ends)
        planes = len(self._near) * len(self.half_spaces)
        if which >= planes:
            _, first, second = self._between(points)
            return np.stack([first[0, which - planes], second[0, which - planes]])
        end, number = divmod(which, len(self.half_spaces))
        half, point = self.half_spaces[number], points[0, self._near[end]]
        normal = np.array(half.normal)
        return np.stack([point, point - (normal @ point + half.offset) * normal])

    # ------------------------------------------------------------------------------ at every instant

    def _reach(self, joints: Index) -> Array:
        """Distance (.., ) from the base to the frames moved by so many joints, along the links; m."""
        lengths = [float(np.linalg.norm(joint.placement.position)) for joint in self.arm.chain]
        return np.concatenate([[0.0], np.cumsum(lengths)])[joints]

    def lowest(self, motion: Trajectory) -> Array:
        """(S,): a bound from below on each clearance at every instant, m.

        Between two instants h apart a function differs from its chord by at most h²/8 times a bound on its second
        derivative: of n.p the acceleration a, of the distance |r| of two points, whose second derivative is
        (|r'|² - (u.r')²) / |r| + u.r'', the bound v² / |r| + a on it from above, which is the one that counts. A
        capsule's distance is the least of such functions.
        """
        coarse = self.values(motion.derivative(_grid(motion, FEWEST_INSTANTS), 0))
        planes = coarse.shape[1] - len(self.pairs)
        gap = np.maximum(coarse[:, planes:].min(axis=0) + self._apart[2], MARGIN)
        speed, acceleration = self._rates(motion)
        bend = acceleration + np.append(np.zeros(planes), speed[planes:] ** 2 / (SMALLEST_GAP * gap))
        steps = np.sqrt(8 * MARGIN / np.maximum(bend, np.finfo(float).tiny))
        count = int(np.clip(np.ceil(motion.period / steps.min()), FEWEST_INSTANTS, MOST_INSTANTS))
        values = self.values(motion.derivative(_grid(motion, count), 0))
        step = motion.period / count
        low = values.min(axis=0)
        smooth = low - step**2 / 8 * bend
        # Where the distance may have come below what `bend` supposes, only the speed bounds it.
        near = low[planes:] + self._apart[2] - speed[planes:] * step < SMALLEST_GAP * gap
        smooth[planes:] = np.where(near, low[planes:] - speed[planes:] * step, smooth[planes:])
        return np.asarray(smooth)

    def _rates(self, motion: Trajectory) -> tuple[Array, Array]:
        """Bounds (S,) on the speeds and the accelerations that count for each, m/s and m/s².

        As of the tip (`design.limits.tip_acceleration_bound`), with g_j the largest distance from joint j's axis: of a
        capsule's points in the world, or of two capsules those of the outer one as the inner one sees them, which only
        the joints between both move.
        """
        first, second = (np.abs(motion.enclosure(order)).max(axis=0) for order in (1, 2))
        slides = np.array([joint.kind is JointKind.PRISMATIC for joint in self.arm.chain])
        length = np.array([np.linalg.norm(joint.placement.position) for joint in self.arm.chain])
        length = length + slides * np.abs(motion.enclosure(0)).max(axis=0)
        sizes = [max(float(np.linalg.norm(end)) for end in (c.start, c.end)) for c in self.capsules]

        @cache
        def between(inner: int, capsule: int) -> tuple[float, float]:
            joints = slice(inner, self.capsules[capsule].joint)
            lever = sizes[capsule] + np.append(np.cumsum(length[joints][:0:-1])[::-1], 0.0)
            lever = np.where(slides[joints], 1.0, lever)
            later = np.maximum.outer(np.arange(len(lever)), np.arange(len(lever)))
            rate = first[joints]
            return float(lever @ rate), float(lever @ second[joints] + rate @ lever[later] @ rate)

        half_spaces = [between(0, int(end) // 2) for end in self._near for _ in self.half_spaces]
        ordered = [sorted(pair, key=lambda capsule: self.capsules[capsule].joint) for pair in self.pairs]
        pairs = [between(self.capsules[inner].joint, outer) for inner, outer in ordered]
        speed, acceleration = np.array([*half_spaces, *pairs]).reshape(-1, 2).T
        return speed, acceleration


def nearest_on_segments(a: Array, along: Array, b: Array, beside: Array) -> tuple[Array, Array]:
    """Shares s, t (..) in [0, 1] of the nearest points a + s along and b + t beside of segments (.., 3).

    The nearest points of the lines where both are inside; else the best of each end with its nearest on the other.
    """
    r = a - b
    aa, bb, ab = (np.einsum("...i,...i->...", x, y) for x, y in ((along, along), (beside, beside), (along, beside)))
    ar, br = np.einsum("...i,...i->...", along, r), np.einsum("...i,...i->...", beside, r)

    def share(top: Array, bottom: Array) -> Array:
        return np.clip(np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0), 0.0, 1.0)

    zero, one = np.zeros_like(ar), np.ones_like(ar)
    inner = share(ab * br - bb * ar, aa * bb - ab**2)
    candidates = [
        (inner, share(br + inner * ab, bb)),
        (zero, share(br, bb)),
        (one, share(br + ab, bb)),
        (share(-ar, aa), zero),
        (share(ab - ar, aa), one),
    ]
    squared = np.stack([s**2 * aa + t**2 * bb - 2 * s * t * ab + 2 * s * ar - 2 * t * br for s, t in candidates])
    best = squared.argmin(axis=0)[None]
    s, t = (np.take_along_axis(np.stack(shares), best, 0)[0] for shares in zip(*candidates, strict=True))
    return s, t


def _grid(motion: Trajectory, count: int) -> Array:
    return np.linspace(0.0, motion.period, count + 1)


def clearances(workspace: Workspace | None, arm: Arm | None, position: Array) -> Clearances | None:
    """The clearances that a workspace asks of an arm with position limits (n, 2); None where it asks for none.

    Raises InputError for capsules of an arm that is not from a URDF.
    """
    if workspace is None or not workspace.capsules:
        return None
    if not isinstance(arm, SpatialArm):
        what = "capsules were given, and the arm is not from a URDF"
        raise InputError(what=what, where="capsule", remedy="state robot.urdf, or leave out [[capsule]]")
    return _clearances(workspace, arm, tuple(map(tuple, position.tolist())))


@lru_cache(maxsize=16)
def _clearances(workspace: Workspace, arm: SpatialArm, position: tuple[tuple[float, float], ...]) -> Clearances | None:
    pairs = tuple(_pairs(workspace.capsules))
    slides = [joint.kind is JointKind.PRISMATIC for joint in arm.chain]
    strokes = float(np.abs(position).max(axis=1)[slides].sum())
    whole = Clearances(arm, workspace.capsules, workspace.half_spaces, pairs, workspace.clearance, strokes)
    if pairs:
        low, high = np.array(position).T
        postures = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
        parts = np.any(whole.values(postures)[:, -len(pairs) :] > 0, axis=0)
        kept = tuple(pair for number, pair in enumerate(pairs) if parts[number])
        whole = replace(whole, pairs=kept)
    return whole if whole.names else None


def _pairs(capsules: tuple[Capsule, ...]) -> Iterator[tuple[int, int]]:
    """Capsules that can come nearer to one another, but those of neighbouring links."""
    for (i, one), (j, other) in combinations(enumerate(capsules), 2):
        fixed = 0 in (one.joint, other.joint)
        if one.joint != other.joint and (fixed or abs(one.joint - other.joint) > NEIGHBOURS):
            yield i, j
