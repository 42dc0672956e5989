"""Place: where a motion is designed for, an arm and its limits, and whether a motion can be there at all."""

from __future__ import annotations

from design.motion.series import Series
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.rig import Limits, Rig


def place_of(rig: Rig) -> tuple[Arm, Limits]:
    """The arm and the limits of a rig.

    Raises InputError when it states none, or limits that no motion keeps which comes back to where it began.
    """
    if rig.arm is None:
        what = "a motion is designed for an arm, and the rig has none"
        raise InputError(what=what, where="rig", remedy="state robot.link_lengths or robot.urdf")
    if rig.limits is None:
        what = "a motion is designed within limits, and the rig states none"
        raise InputError(what=what, where="rig", remedy="add [limits] with position, velocity and acceleration")
    for name in ("velocity", "acceleration"):
        low, high = getattr(rig.limits, name).T
        if not ((low < 0) & (high > 0)).all():
            what = f"limits of {name} on both sides of zero were expected, and of one joint they are not"
            raise InputError(what=what, where="limits", remedy="a motion that comes back turns round: allow both ways")
    return rig.arm, rig.limits


def require_samples(series: Series, samples: int) -> None:
    """InputError for fewer samples than the series has functions of time: they could not follow it."""
    functions = series.mixing.shape[1]
    if samples < functions:
        what = f"{samples} samples cannot follow a series of {functions} functions of time"
        raise InputError(
            what=what, where="samples", remedy=f"take {2 * functions} or more, or fewer harmonics or knots"
        )
