"""Arm and limits of a rig, checked to admit a periodic trajectory; period and samples that suit a series."""

from __future__ import annotations

from design.trajectories.trajectory import TrajectorySeries
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.rig.rig import Limits, Rig

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
    period at a, half at -a.
    """
    strokes = abs(limits.acceleration).max(axis=1) * series.duration**2 / 16
    low, high = limits.position.T
    if not (strokes > SMALLEST_STROKE * (high - low)).any():
        what = f"in a period of {series.duration:.3g} s no joint can move by a millionth of its range"
        raise InputError(what=f"{what} within its acceleration limits", where="period", remedy="take a longer period")
