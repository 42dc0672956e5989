"""Direction of gravity in base axes, estimated from how the tool's weight turns with the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.evidence.weight_fit import WeightFit
from estimation.gravity.weight_moments import FreeFit, WeightMoments
from modeling.kinematics.base_mounting import Direction
from modeling.rig.rig import Convention

Array = NDArray[np.float64]

ALIKE = 2.0
"""Ratio of residuals up to which an axis explains the readings about as well as a direction a few degrees beside it."""
TILT = radians(15)
"""A base within this angle of the vertical stands upright, or hangs: the rest is left to the effect `gravity_tilt`."""
NEAR_AXIS = radians(5)
"""Within it an axis that explains the readings about as well is the direction."""
UNLIKE = radians(30)
"""A direction further than this from the best is another one, which must not explain the readings as well."""
FEWEST_POSES = 10
"""Samples from which a direction is estimated: it has two parameters more than a mass, its mounting and its zero."""
SIGN_SIGNIFICANCE = 5.0
"""Std between gravity along a direction and against it, by the accelerations, from which they decide."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityEstimate:
    """The direction of gravity with its evidence, beside that of a base that stands upright.

    direction   unit vector in base axes: the axis that it is next to, or as estimated
    rival       the best of the directions that are unlike it: where that explains as much, none is identifiable
    fit         with gravity along it; `upright` with gravity down
    decided     whether accelerations decide between it and its opposite; poses at rest cannot
    mounted     the direction before it was turned by the tilt that a fit found beside the tool; None if it was not
    cable       the fit of an upright base with a cable on the tool, where that explains the forces as well, so that
                gravity is taken as down; else None
    """

    direction: Direction
    rival: Direction
    fit: FreeFit
    upright: FreeFit
    decided: bool
    mounted: Direction | None = None
    cable: WeightFit | None = None

    @property
    def is_upright(self) -> bool:
        """Whether gravity points down, or nearly."""
        return self.direction == upright_direction(len(self.direction))

    @property
    def along_axis(self) -> bool:
        """Whether it is an axis of the base."""
        return max(map(abs, self.direction)) == 1.0

    @property
    def place(self) -> str:
        """The direction in words: `along x of the base`."""
        words = direction_in_words(self.direction)
        if self.decided:
            return f"{words} of the base"
        return f"{words} of the base (or opposite, with the other sign convention: poses at rest cannot tell)"

    @property
    def evidence(self) -> str:
        """Mass and residual with it and without."""
        found = f"with its direction free the mass is {self.fit.mass:.3g} kg and the residual of the weight falls from"
        return f"{found} {self.upright.rms:.3g} to {self.fit.rms:.3g} N"

    @property
    def sentence(self) -> str:
        """What was found, as a sentence."""
        tilted = "" if self.mounted is None else ", with the tilt that was fitted beside the tool"
        return f"Gravity points {self.place}{tilted}: {self.evidence} (upright: {self.upright.mass:.3g} kg)."

    @property
    def not_applied(self) -> str:
        """Why gravity is taken as down nevertheless, as a sentence; empty where it is not."""
        if self.cable is None:
            return ""
        cable = f"a cable that pulls the tool explains the forces as well, with {self.cable.mass:.3g} kg"
        remedy = f"If the base is mounted so, write {self.stated} under [robot] in the rig."
        return f"Gravity is taken as down, though it may point {self.place}: {self.evidence}, but {cable}. {remedy}"

    @property
    def meaning(self) -> str:
        """What the readings may show, in words: gravity's direction, or the cable instead of it."""
        if self.cable is None:
            return f"gravity points {self.place}"
        size = f"{self.cable.mass:.3g} kg, residual {self.cable.rms:.3g} N"
        return f"a cable pulls the tool ({size}), or gravity points {self.place}"

    @property
    def advice(self) -> str:
        """What to do about it."""
        line = f"state {self.stated} under [robot] in the rig"
        return line if self.cable is None else f"gravity is taken as down; if the base is mounted so, {line}"

    @property
    def stated(self) -> str:
        """The line of a rig file that states it."""
        return f"gravity_direction = [{', '.join(f'{c:.4g}' for c in self.direction)}]"

    def to_data(self) -> dict[str, Any]:
        """The finding as data: kg and N, with the direction and with gravity down."""
        return {
            "direction": list(self.direction),
            "mounted": None if self.mounted is None else list(self.mounted),
            "decided": self.decided,
            "mass": self.fit.mass,
            "rms": self.fit.rms,
            "mass_upright": self.upright.mass,
            "rms_upright": self.upright.rms,
        }


def upright_direction(axes: int) -> Direction:
    """Gravity in base axes where the base stands upright: along -y in the plane, -z in six axes."""
    return (0.0, -1.0) if axes == 2 else (0.0, 0.0, -1.0)


def independent_samples(samples: int, *, at_rest: bool) -> int:
    """All poses, and a thousandth of a run (its residual is strongly correlated)."""
    return samples if at_rest else max(5, samples // 1000)


def direction_in_words(direction: Direction) -> str:
    """`along -x`, or `along (0.50, 0.00, -0.87)`."""
    axis = int(np.argmax(np.abs(direction)))
    if abs(direction[axis]) == 1.0:
        return f"along {'-' if direction[axis] < 0 else ''}{'xyz'[axis]}"
    return f"along ({', '.join(f'{c + 0.0:.2f}' for c in direction)})"


def estimated_gravity(
    moments: WeightMoments,
    independent: int,
    convention: Convention = Convention.AUTO,
    *,
    near_axis: float = NEAR_AXIS,
) -> GravityEstimate:
    """The direction of gravity in base axes; whether it is shown, `gravity_evidence` tests.

    With B and d, -B and -d fit the weight alike, and only accelerations distinguish them, by the likelihood of
    `independent` samples. Where they do not, the convention does; where it is not stated, gravity points rather down
    than up, and sideways the readings are ON_SENSOR, as those of most commercial sensors. Within `near_axis` (rad) of a
    level axis that explains the readings about as well, the direction is that axis.
    """
    best = moments.best_direction
    found, opposite = moments.fit(best), moments.fit(-best)
    gain = independent * ((opposite.rms / max(found.rms, 1e-300)) ** 2 - 1)
    decided = bool(gain > SIGN_SIGNIFICANCE**2)
    direction = _snapped(best, moments, near_axis)
    if not decided and _is_opposite(direction, found, convention):
        direction = tuple(-c + 0.0 for c in direction)
    return GravityEstimate(
        direction=direction,
        rival=_plain(moments.rival(best, UNLIKE)),
        fit=moments.fit(direction),
        upright=moments.fit(upright_direction(moments.axes)),
        decided=decided,
    )


def _snapped(direction: Array, moments: WeightMoments, near_axis: float) -> Direction:
    """The axis next to a direction: where that is vertical, or where it explains the readings about as well."""
    number = int(np.argmax(np.abs(direction)))
    axis = np.sign(direction[number]) * np.eye(len(direction))[number]
    angle, vertical = acos(min(1.0, float(axis @ direction))), number == len(direction) - 1
    alike = moments.fit(axis).rms < ALIKE * moments.fit(direction).rms
    return _plain(axis if angle < (TILT if vertical else near_axis) and (vertical or alike) else direction)


def _plain(direction: Array) -> Direction:
    return tuple(float(component) + 0.0 for component in direction)


def _is_opposite(direction: Direction, found: FreeFit, convention: Convention) -> bool:
    """Whether the opposite direction is meant, of two that the data do not distinguish."""
    on_tool = float(np.linalg.det(found.matrix)) > 0
    if convention is not Convention.AUTO:
        return on_tool is not (convention is Convention.ON_TOOL)
    if abs(direction[-1]) > np.sin(TILT):
        return direction[-1] > 0
    return on_tool
