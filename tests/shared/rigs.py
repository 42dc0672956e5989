"""Rigs of the tests: simulated ones, and what models are told of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from modeling.kinematics.arm import PlanarArm, SpatialArm
from modeling.kinematics.urdf import read_urdf
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.places import URDF
from truewrench.simulated_rig import PlanarRig, SimulatedRig, SpatialRig

ARM = PlanarArm((1.0, 0.97, 0.4))
"""The links of the simulated planar rig, m."""
ARM_TEXT = "[robot]\nlink_lengths = [1.0, 0.97, 0.4]\n"
"""A rig file that says no more than these."""
ARM_RIG = Rig(link_lengths=ARM.link_lengths)
RIG = Rig(link_lengths=ARM.link_lengths, tip_length=0.2)
"""The simulated planar rig as its owner describes it: the links, and how far the tip reaches beyond the sensor."""
SIMULATED: Mapping[Space, SimulatedRig] = {Space.PLANE: PlanarRig(), Space.SPACE: SpatialRig()}
FRAMES = {"elbow": "tool0", "seven": "l8", "slide": "sensor", "planar": "sensor", "carriage": "sensor"}
"""The sensor's frame in each file of the folder URDF."""

FULL_INERTIA = 1e-10
"""N and N m that MuJoCo's principal axes of a full inertia leave of 100 N."""


def spatial_arm(name: str) -> SpatialArm:
    """The arm of that name in the folder URDF, to its sensor."""
    return read_urdf(URDF / f"{name}.urdf", FRAMES[name])


def described(rig: SimulatedRig) -> Rig | None:
    """What is said of a simulated rig: of the one in six axes nothing, as its recordings have poses."""
    return RIG if isinstance(rig, PlanarRig) else None


def carrying(rig: SpatialRig, mass: float, at: Sequence[float]) -> SpatialRig:
    """The simulated rig with a point mass (kg) at a place (m) beside its tool: sums over its masses."""
    x, y, z = at
    moments = np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    first = [moment + mass * coordinate for moment, coordinate in zip(rig.first_moment, at, strict=True)]
    return replace(
        rig,
        mass=rig.mass + mass,
        first_moment=(first[0], first[1], first[2]),
        inertia=tuple((np.array(rig.inertia) + mass * moments).tolist()),
    )
