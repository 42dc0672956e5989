"""Tip position along a trajectory, its guaranteed bounds, and the workspace limits."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.trajectories.grid_bound import grid_bound
from design.trajectories.trajectory import Array, Trajectory
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.kinematics.joint import JointKind
from modeling.kinematics.planar_arm import PlanarArm
from modeling.kinematics.spatial_arm import SpatialArm
from modeling.rig.rig import Workspace


@lru_cache(maxsize=16)
def _tip(arm: Arm, tip_length: float) -> Any:
    return arm.tip(tip_length)


def tip_path(motion: Trajectory, arm: Arm, tip_length: float, time: Array) -> Array:
    """The tip's position at the times (N,) in s: (N, 2), x right and y up, or (N, 3), z up; m."""
    q = motion.derivative(time, 0)
    return np.array(_tip(arm, tip_length).map(len(q))(q.T)).T


def tip_enclosure(motion: Trajectory, arm: Arm, tip_length: float) -> tuple[Array, Array]:
    """Bounds low and high of the tip's coordinates, (2,) or (3,) each, m, at every instant of the trajectory."""
    ends = np.array([0.0, motion.period])
    size = tip_path(motion, arm, tip_length, ends[:1]).shape[1]
    second = np.full((1, size), tip_acceleration_bound(motion, arm, tip_length))
    return grid_bound(lambda time: tip_path(motion, arm, tip_length, time), second, ends)


def tip_acceleration_bound(motion: Trajectory, arm: Arm, tip_length: float) -> float:
    """A bound on the tip's acceleration, m/s², at every instant of the trajectory.

    With z_j the direction of joint j's axis and r_j the vector from it to the tip, dP/dq_j = z_j x r_j of a revolute
    joint and z_j of a prismatic one; a joint i before j, or j itself, rotates that vector: d²P/dq_i dq_j =
    z_i x dP/dq_j, or zero where i is prismatic. So with g_j at least |r_j|, or 1,

        |P''| <= sum_j g_j |ddq_j| + sum_ij g_max(i,j) |dq_i| |dq_j|,

    bounded in turn by the joints' enclosures.
    """
    first, second = (np.abs(motion.enclosure(order)).max(axis=0) for order in (1, 2))
    g = lever_arms(motion, arm, tip_length)
    later = np.maximum.outer(np.arange(arm.joints), np.arange(arm.joints))
    return float(g @ second + first @ g[later] @ first)


def lever_arms(motion: Trajectory, arm: Arm, tip_length: float) -> Array:
    """(n,): for each revolute joint the largest distance of the tip from it, m; 1 for a prismatic one.

    It is at most the sum of the links' lengths, the coordinates of later prismatic joints, and the tip length.
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
    """The stated workspace limits by name: index of the tip's coordinate, and its low and high in m.

    Raises InputError when the plane of the arm has no such coordinate.
    """
    stated = {} if workspace is None else {n: side for n, side in vars(workspace).items() if side is not None}
    if isinstance(arm, PlanarArm) and "z" in stated:
        what = "limits of x and y were expected of a planar arm, and limits of z came"
        raise InputError(what=what, where="workspace", remedy="limit y, which points up")
    return {name: ("xyz".index(name), side) for name, side in stated.items()}


def joint_units(arm: Arm | None, joints: int) -> tuple[str, ...]:
    """The unit of each coordinate: m of a prismatic joint, else rad."""
    sliding = _slides(arm) if isinstance(arm, SpatialArm) else np.zeros(joints, dtype=bool)
    return tuple("m" if slides else "rad" for slides in sliding)


def _slides(arm: SpatialArm) -> NDArray[np.bool_]:
    return np.array([joint.kind is JointKind.PRISMATIC for joint in arm.chain])
