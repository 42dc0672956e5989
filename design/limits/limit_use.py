"""LimitUse: the share of its limits that a trajectory uses, at every instant and not at the samples only."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from design.limits.tip_workspace import joint_units, tip_enclosure, workspace_sides
from design.trajectories.trajectory import Array, Trajectory
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.rig.rig import Limits, Workspace
from modeling.table import Column, Table, Tabular, Value

LIMITED_DERIVATIVES = {"position": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
"""Limited quantities by the order of their derivative, and the suffix of their unit to the coordinate's."""


@dataclass(frozen=True, kw_only=True)
class LimitedQuantity:
    """The range of one quantity of one joint (or of one coordinate of the tip), and its limits, in `unit`.

    quantity is position, velocity, acceleration, jerk or workspace; name is q1 .. qn, or x, y or z of the tip.
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
        return cls(limited_quantities=(*_joints(motion, limits, arm), *_tip(motion, workspace, arm, tip_length)))

    @cached_property
    def worst(self) -> LimitedQuantity:
        """The quantity with the largest use."""
        return max(self.limited_quantities, key=lambda quantity: quantity.use)

    @cached_property
    def by_quantity(self) -> Mapping[str, LimitedQuantity]:
        """The largest use of each limited quantity, in the order of `LIMITED_DERIVATIVES`, then the workspace."""
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


def _require_intervals(joints: int, limits: Limits, workspace: Workspace | None) -> None:
    """InputError unless every limit is finite with low below high: use is a share of the interval's half width."""
    pairs = {name: np.asarray(pair) for name, pair in vars(limits).items() if pair is not None}
    sides = {} if workspace is None else {name: side for name, side in vars(workspace).items() if side is not None}
    given = pairs | {name: np.array([side]) for name, side in sides.items()}
    for name, pair in given.items():
        rows = joints if name in pairs else 1
        if pair.shape != (rows, 2) or not (np.isfinite(pair).all() and (pair[:, 0] < pair[:, 1]).all()):
            what = f"{rows} finite [low, high] with low below high were expected of {name}"
            raise InputError(what=what, where="limits", remedy="state a far limit where the quantity has none")


def _joints(motion: Trajectory, limits: Limits, arm: Arm | None) -> Iterator[LimitedQuantity]:
    pairs = (limits.position, limits.velocity, limits.acceleration, limits.jerk)
    names = [f"q{j}" for j in range(1, motion.joints + 1)]
    for order, ((quantity, per), pair) in enumerate(zip(LIMITED_DERIVATIVES.items(), pairs, strict=True)):
        if pair is not None:
            if order > motion.series.smoothness:
                what = f"{quantity} is limited, and that of this series is not finite: {motion.series}"
                raise InputError(what=what, where="limits", remedy="take a smoother series, or leave out the limit")
            units = [unit + per for unit in joint_units(arm, motion.joints)]
            yield from _limited_quantities(quantity, names, units, motion.enclosure(order), pair)


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


def _limited_quantities(
    quantity: str, names: list[str], units: list[str], ends: tuple[Array, Array], limits: Array
) -> Iterator[LimitedQuantity]:
    for name, unit, low, high, (least, most) in zip(names, units, *ends, limits, strict=True):
        limit = (float(least), float(most))
        yield LimitedQuantity(quantity=quantity, name=name, unit=unit, low=float(low), high=float(high), limit=limit)
