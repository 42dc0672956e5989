"""Designs of six axes: informative, and within every limit between the samples by Pinocchio's kinematics."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from design.exciting_trajectory import ExcitingTrajectory
from design.optimiser.interior_point import TerminationStatus
from design.trajectories.fourier import FreeSeries
from design.trajectory_design import design
from modeling.rig import Rig
from tests.shared.places import URDF

Array = NDArray[np.float64]
DENSE = 4001
"""Instants: 800 to the shortest of five waves, between which a limit that holds on all is passed by 8e-6 at most."""
ROUNDING = 1e-9
FRAME = "tool0"
PERIOD, TIP = 8.0, 0.15
ROOM = (0.3, 1.3)
"""Of the tip's height, m."""


@cache
def rig() -> Rig:
    limits = {
        "position": [[-2.0, 2.0], [-1.6, 1.2], [-1.5, 2.0], [-2.5, 1.5], [-2.0, 2.0], [-2.5, 2.5]],
        "velocity": [1.5, 1.5, 1.5, 2.0, 2.0, 2.0],
        "acceleration": [4.0, 4.0, 4.0, 8.0, 8.0, 8.0],
    }
    robot = {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": FRAME, "tip_length": TIP}
    return Rig.from_data({"robot": robot, "limits": limits, "workspace": {"z": list(ROOM)}})


@cache
def plan() -> ExcitingTrajectory:
    series = FreeSeries(joints=6, harmonics=(1, 2, 3, 4, 5), period=PERIOD)
    return design(rig(), series=series, samples=120, starts=2, bounded=False)


def motion_of_pinocchio(positions: Array, frame: str) -> tuple[Array, Array]:
    """The frame's origin (N, 3), m, and its axes as columns (N, 3, 3), at positions (N, 6)."""
    model = pinocchio.buildModelFromUrdf(str(URDF / "elbow.urdf"))
    data, index = model.createData(), model.getFrameId(frame)
    origins, axes = np.empty((len(positions), 3)), np.empty((len(positions), 3, 3))
    for row, q in enumerate(positions):
        pinocchio.framesForwardKinematics(model, data, np.append(q, [0.0, 0.0]))
        origins[row], axes[row] = data.oMf[index].translation, data.oMf[index].rotation
    return origins, axes


@pytest.mark.long(8)
def test_a_design_of_six_axes_keeps_its_limits_between_the_samples() -> None:
    """Of a random motion within the same limits ln det is 10 to 20 lower"""
    limits, found = rig().limits, plan()
    assert limits is not None
    assert found.local_optima[0].outcome is TerminationStatus.CONVERGED
    time = np.linspace(0.0, PERIOD, DENSE)
    for order, pairs in enumerate((limits.position, limits.velocity, limits.acceleration)):
        values = found.motion.derivative(time, order)
        assert (values >= pairs[:, 0] - ROUNDING).all()
        assert (values <= pairs[:, 1] + ROUNDING).all()
    origins, axes = motion_of_pinocchio(found.motion.derivative(time, 0), FRAME)
    height = (origins + TIP * axes[:, :, 2])[:, 2]
    assert ROOM[0] - ROUNDING <= height.min()
    assert height.max() <= ROOM[1] + ROUNDING
    use = found.limit_use.by_quantity
    assert max(use["velocity"].use, use["acceleration"].use) > 0.99
    random = [found.task.random((9, number)) for number in range(5)]
    assert found.logdet > max(found.task.objective.value(motion.coefficients) for motion in random) + 10
