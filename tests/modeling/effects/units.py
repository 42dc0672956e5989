"""The units of an effect's parameters: that its equation holds in every system of them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from functools import cache
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.formulas.units import dimension
from modeling.kinematics import perturbed_arm
from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.kinematics.placement import Placement
from tests.modeling.effects.cases import Case
from tests.modeling.effects.parts import part, part_units, random_signals

Array = NDArray[np.float64]

SAMPLES = 16
LINES = np.array([1.0, 5.0, 30.0])
"""rad/s."""
FACTORS: Mapping[str, float] = {"kg": 1.3, "m": 0.7, "s": 1.6, "K": 0.4}
"""Of our units in a foreign one: a kilogram is 1.3 of theirs."""
SIGNAL_UNITS: Mapping[str, str] = (
    dict.fromkeys(("phi", "qx", "qy", "qz", "qw", "progress", "bend", "bend_x", "bend_y", "bend_z"), "1")
    | dict.fromkeys(("dphi", "wx", "wy", "wz", "dbend", "dbend_x", "dbend_y", "dbend_z"), "rad/s")
    | dict.fromkeys(("ddphi", "alx", "aly", "alz", "ddbend", "ddbend_x", "ddbend_y", "ddbend_z"), "rad/s²")
    | dict.fromkeys(("px", "py", "pz"), "m")
    | dict.fromkeys(("vx", "vy", "vpx", "vpy", "vpz"), "m/s")
    | dict.fromkeys(("ax", "ay", "apx", "apy", "apz"), "m/s²")
    | {"time": "s", "temperature": "K"}
)
OWN_CONSTANTS = 1e-6
"""Constants of the project's own are not converted: 1e-6 m and 1e-6 m/s, which round off speeds and distances, show in
less. Temperatures count from 20 °C, and times keep off the edges."""


def units_are_consistent(case: Case) -> None:
    """Everything in other units of mass, length, time and temperature, each by its stated unit: the readings follow.

    A parameter whose stated unit is not that of its place in the equation does not scale as it should.
    """
    wrong = departure(case, foreign_theta(case))
    assert wrong < OWN_CONSTANTS, f"{case}: {wrong:.1e} of the largest reading is left in another system of units"


def foreign_theta(case: Case) -> Array:
    """The case's parameters in the foreign system."""
    return case.theta * [ours(p.unit) for p in case.model.parameters]


def departure(case: Case, theta: Array) -> float:
    """Relative departure of the worst channel of the model in the foreign system, at theta there, from ours."""
    worst = 0.0
    for name, units in part_units(case).items():
        mine, other = part(case.model, name), part(foreign(case), name)
        signals = random_signals(case, mine.inputs, SAMPLES, np.random.default_rng(5))
        value = mine.value(signals, case.theta, SAMPLES) * [ours(unit) for unit in units]
        there = other.value({n: in_foreign(case, n, s) for n, s in signals.items()}, theta, SAMPLES)
        worst = max(worst, float((np.abs(there - value).max(axis=0) / np.abs(value).max(axis=0).clip(1e-300)).max()))
    if compiled_prediction(case.model).has_transfer_function:
        gain = compiled_prediction(case.model).transfer(LINES, case.theta)[0]
        foreign_gain = compiled_prediction(foreign(case)).transfer(LINES / ours("s"), theta)[0]
        worst = max(worst, float(np.abs(foreign_gain - gain).max()))
    return worst


@cache
def foreign(case: Case) -> WrenchModel:
    """The case's model with its arm, gravity and the torque around which play is taken up in the foreign system."""
    gravity = case.model.gravity * ours("m/s²")
    model = dataclasses.replace(case.model, gravity=gravity, arm=converted(case.model.arm))
    with mock.patch.object(perturbed_arm, "BACKLASH_TORQUE", perturbed_arm.BACKLASH_TORQUE * ours("N m")):
        for name in part_units(case):
            part(model, name)
    return model


def ours(unit: str) -> float:
    """One of our unit, in the foreign system's."""
    return float(np.prod([FACTORS[base] ** float(power) for base, power in dimension(unit).powers]))


def in_foreign(case: Case, name: str, values: Array) -> Array:
    """A signal in the foreign system."""
    if name == "temperature":
        return (values - 20) * ours("K") + 20
    joint = re.fullmatch(r"(d{0,2})q(\d+)", name)
    if joint is None:
        return values * ours(SIGNAL_UNITS[name])
    assert case.model.arm is not None
    return values * ours(case.model.arm.units[int(joint[2]) - 1]) / ours("s") ** len(joint[1])


def converted(arm: Arm | None) -> Arm | None:
    """The arm with its lengths in the foreign system."""
    metre = ours("m")
    if isinstance(arm, PlanarArm):
        return PlanarArm(tuple(length * metre for length in arm.link_lengths))
    assert isinstance(arm, SpatialArm)
    chain = tuple(dataclasses.replace(joint, placement=larger(joint.placement, metre)) for joint in arm.chain)
    return SpatialArm(chain=chain, sensor=larger(arm.sensor, metre))


def larger(placement: Placement, factor: float) -> Placement:
    """The placement with its position in multiples."""
    x, y, z = (factor * p for p in placement.position)
    return Placement(position=(x, y, z), quaternion=placement.quaternion)
