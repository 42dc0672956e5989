"""Limits of a rig: joints, tip workspace, and the share of them that a trajectory uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.clearance import clearances
from design.joint_torque import joint_torques
from design.trajectories.spline import RestToRest
from design.trajectories.trajectory import Array, Trajectory, TrajectorySeries, grid_bound
from modeling.errors import InputError
from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.kinematics.placement import JointKind
from modeling.rig import Limits, Rig, Workspace
from modeling.table import Column, Table, Tabular, Value

# Tip position along a trajectory, its guaranteed bounds, and the workspace limits.


@lru_cache(maxsize=16)
def _tip_position(arm: Arm, tip_length: float) -> Any:
    return arm.tip(tip_length)


def tip_path(motion: Trajectory, arm: Arm, tip_length: float, time: Array) -> Array:
    """The tip's position at the times (N,) in s: (N, 2), x right and y up, or (N, 3), z up; m."""
    q = motion.derivative(time, 0)
    return np.array(_tip_position(arm, tip_length).map(len(q))(q.T)).T


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
    stated = {} if workspace is None else workspace.sides
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


# LimitUse: the share of its limits that a trajectory uses, at every instant and not at the samples only.


LIMITED_DERIVATIVES = {"position": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
"""Limited quantities by the order of their derivative, and the suffix of their unit to the coordinate's."""


@dataclass(frozen=True, kw_only=True)
class LimitedQuantity:
    """The range of one quantity of one joint (or of one coordinate of the tip), and its limits, in `unit`.

    quantity is position, velocity, acceleration, jerk, torque, workspace or clearance; name is q1 .. qn, x, y or z of
    the tip, or what is kept apart.
    """

    quantity: str
    name: str
    unit: str
    low: float
    high: float
    limit: tuple[float, float]

    @property
    def use(self) -> float:
        """The largest |value - middle| over the limits' half width: 1 touches a limit."""
        return max(self._uses)

    @property
    def side(self) -> str:
        """The nearest limit, "low" or "high"."""
        below, above = self._uses
        return "low" if below > above else "high"

    @property
    def excess(self) -> str:
        """The nearest limit, and by how much it is passed."""
        by = self.limit[0] - self.low if self.side == "low" else self.high - self.limit[1]
        number = f"{by:.2g}" if abs(by) < 100 else f"{by:.0f}"
        return f"the {self.side} limit of the {self.quantity} of {self.name} by {number} {self.unit}"

    @property
    def _uses(self) -> tuple[float, float]:
        middle, half = sum(self.limit) / 2, (self.limit[1] - self.limit[0]) / 2
        return (middle - self.low) / half, (self.high - middle) / half

    def row(self) -> tuple[Value, ...]:
        """The row of the table."""
        return (self.quantity, self.name, self.low, self.high, *self.limit, self.unit, self.use, self.side)


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitUse(Tabular):
    """The range of every limited quantity during a trajectory: enclosures, valid between the samples too.

    Parameters
    ----------
    limited_quantities : tuple of LimitedQuantity
        Each with its range, its limits and the share of them that is used.

    Examples
    --------
    >>> import truewrench as tw
    >>> limit = {"position": [1.0] * 3, "velocity": [5.0] * 3, "acceleration": [40.0] * 3}
    >>> rig = tw.Rig.from_data({"robot": {"link_lengths": [1.0, 0.97, 0.4]}, "limits": limit})
    >>> motion = tw.PaperSeries(period=5.0).chapter_optimum
    >>> bool(tw.LimitUse.of(motion, rig.limits).by_quantity["position"].use < 1)
    True
    """

    limited_quantities: tuple[LimitedQuantity, ...]

    @classmethod
    def of(
        cls,
        motion: Trajectory,
        limits: Limits,
        workspace: Workspace | None = None,
        arm: Arm | None = None,
        tip_length: float | None = None,
    ) -> LimitUse:
        """The use of the joint limits, and of the tip's workspace limits where there are any; tip_length in m.

        Raises InputError when the number of joints differs, or the workspace's arm or tip length is missing.
        """
        if limits.joints != motion.joints:
            what = f"limits of {motion.joints} joints were expected, and of {limits.joints} came"
            raise InputError(what=what, where="limits", remedy="give the limits of the trajectory's arm")
        _require_intervals(motion.joints, limits, workspace)
        tip = _tip(motion, workspace, arm, tip_length)
        apart, torques = _apart(motion, limits, workspace, arm), _torques(motion, limits, arm)
        return cls(limited_quantities=(*_joints(motion, limits, arm), *torques, *tip, *apart))

    @cached_property
    def worst(self) -> LimitedQuantity:
        """The quantity with the largest use."""
        return max(self.limited_quantities, key=lambda quantity: quantity.use)

    @cached_property
    def by_quantity(self) -> Mapping[str, LimitedQuantity]:
        """The largest use of each: of `LIMITED_DERIVATIVES` in their order, then torque, workspace, clearance."""
        names = dict.fromkeys(limited.quantity for limited in self.limited_quantities)
        return {n: max((x for x in self.limited_quantities if x.quantity == n), key=lambda x: x.use) for n in names}

    def to_data(self) -> dict[str, float]:
        """`worst_limit_use` of FORMATS: the largest use of each limited quantity."""
        return {name: limited.use for name, limited in self.by_quantity.items()}

    @property
    def table(self) -> Table:
        """Range, limit and use of each quantity."""
        numbers = (Column(name, format=".4g") for name in ("from", "to", "low", "high"))
        columns: tuple[Column | str, ...] = ("quantity", "of", *numbers, "unit", Column("use", format=".4f"), "nearest")
        return Table.of(columns, [limited.row() for limited in self.limited_quantities])

    def remarks(self) -> list[str]:
        """The largest use."""
        return [self.sentence()]

    def sentence(self) -> str:
        """The largest use as a sentence."""
        at, share = self.worst, f"{100 * self.worst.use:.2f} %"
        state = "within" if at.use <= 1 else "beyond"
        return f"{state} the limits: {at.quantity} of {at.name} uses {share} of its {at.side} limit"


def use_at_rest(
    q: Array, limits: Limits, workspace: Workspace | None, arm: Arm | None, tip_length: float | None
) -> Array:
    """(N,): the largest use of a limit by an arm that rests at positions (N, n)."""
    values, pairs, sides = [q], [limits.position], workspace_sides(workspace, arm)
    loads, apart = joint_torques(limits, arm), clearances(workspace, arm, limits.position)
    if loads is not None:
        values.append(loads.values(q, np.zeros_like(q), np.zeros_like(q)))
        pairs.append(loads.room)
    if sides and arm is not None:
        tip = np.array(_tip_position(arm, tip_length or 0.0).map(len(q))(q.T)).T
        values.append(tip[:, [index for index, _ in sides.values()]])
        pairs.append(np.array([side for _, side in sides.values()]))
    if apart is not None:
        values.append(apart.values(q))
        pairs.append(np.tile([0.0, apart.largest], (len(apart.names), 1)))
    low, high = np.vstack(pairs).T
    return np.asarray((np.abs(np.hstack(values) - (low + high) / 2) / ((high - low) / 2)).max(axis=1))


def _require_intervals(joints: int, limits: Limits, workspace: Workspace | None) -> None:
    """InputError unless every limit is finite with low below high: use is a share of the interval's half width."""
    pairs = {name: np.asarray(pair) for name, pair in limits.pairs.items()}
    if limits.torque is not None:
        pairs["torque"] = np.asarray(limits.torque.allowed)
    sides = {} if workspace is None else workspace.sides
    given = pairs | {name: np.array([side]) for name, side in sides.items()}
    for name, pair in given.items():
        rows = joints if name in pairs else 1
        if pair.shape != (rows, 2) or not (np.isfinite(pair).all() and (pair[:, 0] < pair[:, 1]).all()):
            what = f"{rows} finite [low, high] with low below high were expected of {name}"
            raise InputError(what=what, where="limits", remedy="state a far limit where the quantity has none")


def _joints(motion: Trajectory, limits: Limits, arm: Arm | None) -> Iterator[LimitedQuantity]:
    names = [f"q{j}" for j in range(1, motion.joints + 1)]
    for order, (quantity, per) in enumerate(LIMITED_DERIVATIVES.items()):
        if quantity in limits.pairs:
            if order > motion.series.smoothness:
                what = f"{quantity} is limited, and that of this series is not finite: {motion.series}"
                raise InputError(what=what, where="limits", remedy="take a smoother series, or leave out the limit")
            units = [unit + per for unit in joint_units(arm, motion.joints)]
            yield from _limited_quantities(quantity, names, units, motion.enclosure(order), limits.pairs[quantity])


def _torques(motion: Trajectory, limits: Limits, arm: Arm | None) -> Iterator[LimitedQuantity]:
    """The joints' torques, Coulomb's friction either way included."""
    loads = joint_torques(limits, arm)
    if loads is not None:
        ends = loads.enclosure(motion)
        yield from _limited_quantities("torque", loads.names, loads.units, ends, loads.limits.allowed)


def _tip(
    motion: Trajectory, workspace: Workspace | None, arm: Arm | None, tip_length: float | None
) -> Iterator[LimitedQuantity]:
    sides = workspace_sides(workspace, arm)
    if not sides:
        return
    if tip_length is not None and tip_length < 0:
        what = f"a tip length of zero or more was expected, and {tip_length} m came"
        raise InputError(what=what, where="workspace", remedy="give it in m, along the tip from the sensor")
    if arm is None or tip_length is None:
        missing = "link_lengths or urdf" if arm is None else "tip_length"
        what = f"the workspace limits the tip, and {missing} is not stated"
        raise InputError(what=what, where="workspace", remedy=f"state robot.{missing}, or leave out the workspace")
    low, high = tip_enclosure(motion, arm, tip_length)
    index = [i for i, _ in sides.values()]
    pairs = np.array([side for _, side in sides.values()])
    yield from _limited_quantities("workspace", list(sides), ["m"] * len(sides), (low[index], high[index]), pairs)


def _apart(
    motion: Trajectory, limits: Limits, workspace: Workspace | None, arm: Arm | None
) -> Iterator[LimitedQuantity]:
    """The smallest clearance of each pair, beyond what is asked for; its use is a share of half the arm's reach."""
    asked = clearances(workspace, arm, limits.position)
    if asked is not None:
        for name, low in zip(asked.names, asked.lowest(motion), strict=True):
            limit = (0.0, asked.largest)
            yield LimitedQuantity(
                quantity="clearance", name=name, unit="m", low=float(low), high=float(low), limit=limit
            )


def _limited_quantities(
    quantity: str, names: list[str], units: list[str], ends: tuple[Array, Array], limits: Array
) -> Iterator[LimitedQuantity]:
    for name, unit, low, high, (least, most) in zip(names, units, *ends, limits, strict=True):
        limit = (float(least), float(most))
        yield LimitedQuantity(quantity=quantity, name=name, unit=unit, low=float(low), high=float(high), limit=limit)


# Arm and limits of a rig, checked to admit a periodic trajectory; period and samples that suit a series.


SMALLEST_STROKE = 2.0**-20
"""Of a joint's position range: the resolution of an encoder of 20 bits over it."""


def arm_and_limits(rig: Rig) -> tuple[Arm, Limits]:
    """The arm and the limits of a rig.

    Raises InputError when it states none, or limits that no periodic trajectory keeps.
    """
    if rig.arm is None:
        what = "a trajectory is designed for an arm, and the rig has none"
        raise InputError(what=what, where="rig", remedy="state robot.link_lengths or robot.urdf")
    if rig.limits is None:
        what = "a trajectory is designed within limits, and the rig states none"
        raise InputError(what=what, where="rig", remedy="add [limits] with position, velocity and acceleration")
    require_zero_inside(rig.limits)
    return rig.arm, rig.limits


def require_zero_inside(limits: Limits) -> None:
    """InputError unless velocity and acceleration of each joint may have both signs: a periodic trajectory reverses."""
    for name in ("velocity", "acceleration"):
        low, high = getattr(limits, name).T
        if not ((low < 0) & (high > 0)).all():
            what = f"the {name} limits of a joint do not have zero inside: no periodic trajectory is within them"
            raise InputError(what=what, where="limits", remedy="give a negative low and a positive high limit")


def between_poses(series: TrajectorySeries, rig: Rig) -> TrajectorySeries:
    """The series from and to the poses that the rig's limits state; as it is where they state none.

    Raises InputError for a series that is never at rest, and for a pose, or the way between both, beyond a limit.
    """
    limits = rig.limits
    if limits is None or limits.start is None:
        return series
    if not isinstance(series, RestToRest):
        what = f"limits.start is stated, and no motion of this series starts at rest: {series}"
        raise InputError(what=what, where="limits", remedy="take --series rest, or leave out limits.start")
    start, end = (None if pose is None else tuple(pose.tolist()) for pose in (limits.start, limits.end))
    poses = {"limits.start is": (start, None), "limits.end is": (end, None)}
    way = f"the way from limits.start to limits.end in {series.duration:g} s is"
    for called, (first, last) in (poses | {way: (start, end)}).items():
        if first is not None:
            still = replace(series, start=first, end=last)
            motion = Trajectory(still, still.rest(first))
            worst = LimitUse.of(motion, limits, rig.workspace, rig.arm, rig.tip_length).worst
            if worst.use > 1:
                remedy = "take a longer period" if called == way else "state another pose, or widen that limit"
                raise InputError(what=f"{called} beyond {worst.excess}", where="limits", remedy=remedy)
    return replace(series, start=start, end=end)


def require_enough_samples(series: TrajectorySeries, samples: int) -> None:
    """InputError for fewer samples than the series has basis functions of time: they would not resolve it."""
    functions = series.mixing.shape[1]
    if samples < functions:
        what = f"{samples} samples cannot resolve a series of {functions} basis functions of time"
        raise InputError(
            what=what, where="samples", remedy=f"take {2 * functions} or more, or fewer harmonics or knots"
        )


def require_motion_within_period(series: TrajectorySeries, limits: Limits) -> None:
    """InputError for a period in which no joint can move by more than an encoder resolves.

    Within an acceleration of a magnitude up to a, periodic motion travels at most a T² / 16 from end to end: half the
    period at a, half at -a; within a jerk of j its acceleration, which reverses, at most j T / 4.
    """
    reached = {"acceleration": abs(limits.acceleration).max(axis=1)}
    if limits.jerk is not None:
        reached["jerk"] = abs(limits.jerk).max(axis=1) * series.duration / 4
    low, high = limits.position.T
    for name, acceleration in reached.items():
        if not (acceleration * series.duration**2 / 16 > SMALLEST_STROKE * (high - low)).any():
            what = f"in a period of {series.duration:.3g} s no joint can move by a millionth of its range"
            raise InputError(what=f"{what} within its {name} limits", where="period", remedy="take a longer period")
