"""Where the tip of an arm gets during a motion, between the samples too."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.motion.grid_bound import grid_bound
from design.motion.series import Array, Motion
from modeling.arm import PlanarArm
from modeling.errors import InputError
from modeling.joint import JointKind
from modeling.kinematics import Arm
from modeling.rig import Workspace
from modeling.spatial_arm import SpatialArm


@lru_cache(maxsize=16)
def _tip(arm: Arm, tip_length: float) -> Any:
    return arm.tip(tip_length)


def tip_path(motion: Motion, arm: Arm, tip_length: float, time: Array) -> Array:
    """The tip's place at the times (N,) in s: (N, 2), x right and y up, or (N, 3), z up; m."""
    q = motion.derivative(time, 0)
    return np.array(_tip(arm, tip_length).map(len(q))(q.T)).T


def tip_enclosure(motion: Motion, arm: Arm, tip_length: float) -> tuple[Array, Array]:
    """Bounds low and high of the tip's coordinates, (2,) or (3,) each, m, at every instant of the motion."""
    ends = np.array([0.0, motion.period])
    size = tip_path(motion, arm, tip_length, ends[:1]).shape[1]
    second = np.full((1, size), tip_acceleration(motion, arm, tip_length))
    return grid_bound(lambda time: tip_path(motion, arm, tip_length, time), second, ends)


def tip_acceleration(motion: Motion, arm: Arm, tip_length: float) -> float:
    """A bound on the tip's acceleration, m/s², at every instant of the motion.

    With z_j the direction of joint j's axis and r_j the tip as seen from it, dP/dq_j = z_j x r_j where it turns and
    z_j where it slides; a joint i before j, or j itself, turns that along: d²P/dq_i dq_j = z_i x dP/dq_j, or zero where
    i slides. So with g_j at least |r_j|, or 1,

        |P''| <= sum_j g_j |ddq_j| + sum_ij g_max(i,j) |dq_i| |dq_j|,

    bounded in turn by the joints' enclosures.
    """
    first, second = (np.abs(motion.enclosure(order)).max(axis=0) for order in (1, 2))
    g = levers(motion, arm, tip_length)
    later = np.maximum.outer(np.arange(arm.joints), np.arange(arm.joints))
    return float(g @ second + first @ g[later] @ first)


def levers(motion: Motion, arm: Arm, tip_length: float) -> Array:
    """(n,): for each joint that turns, the farthest that the tip can be from it, m; 1 for one that slides.

    It is what lies between: the lengths of the links, the coordinates of later joints that slide, and the tip.
    """
    if isinstance(arm, PlanarArm):
        return np.cumsum([tip_length, *arm.link_lengths[::-1]])[:0:-1]
    if not isinstance(arm, SpatialArm):
        what = f"a planar arm or one from a URDF was expected, and {type(arm).__name__} came"
        raise InputError(what=what, where="workspace", remedy="leave out the workspace")
    slides = _slides(arm)
    coordinate = np.abs(motion.enclosure(0)).max(axis=0)
    length = np.array([np.linalg.norm(joint.placement.position) for joint in arm.chain]) + coordinate * slides
    end = float(np.linalg.norm(arm.sensor.position)) + tip_length
    beyond = end + np.append(length[:0:-1].cumsum()[::-1], 0.0)
    return np.where(slides, 1.0, beyond)


def workspace_sides(workspace: Workspace | None, arm: Arm | None) -> dict[str, tuple[int, tuple[float, float]]]:
    """The sides that are stated, by name: which coordinate of the tip, and its low and high in m.

    Raises InputError when the plane of the arm has no such coordinate.
    """
    stated = {} if workspace is None else {n: side for n, side in vars(workspace).items() if side is not None}
    if isinstance(arm, PlanarArm) and "z" in stated:
        what = "limits of x and y were expected of a planar arm, and limits of z came"
        raise InputError(what=what, where="workspace", remedy="limit y, which points up")
    return {name: ("xyz".index(name), side) for name, side in stated.items()}


def coordinate_units(arm: Arm | None, joints: int) -> tuple[str, ...]:
    """The unit of each coordinate: m of a joint that slides, else rad."""
    sliding = _slides(arm) if isinstance(arm, SpatialArm) else np.zeros(joints, dtype=bool)
    return tuple("m" if slides else "rad" for slides in sliding)


def _slides(arm: SpatialArm) -> NDArray[np.bool_]:
    return np.array([joint.kind is JointKind.PRISMATIC for joint in arm.chain])
