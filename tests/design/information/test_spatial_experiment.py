"""What a motion of a six-axis arm says of the tool's 16 parameters, against Pinocchio's regressor."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from design.criteria import DOptimal
from design.information.experiment import Experiment
from design.limits import LimitUse
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import planar, spatial
from modeling.errors import InputError
from modeling.rig import Convention, Rig
from tests.shared.places import URDF

Array = NDArray[np.float64]

RIG = Rig.from_data(
    {
        "robot": {"urdf": str(URDF / "elbow.urdf"), "sensor_frame": "tool0", "tip_length": 0.15},
        "limits": {"acceleration": [8, 8, 10, 15, 15, 20]},
        "workspace": {"z": [0.1, 2.0], "x": [-1.0, 1.5]},
    }
)
MODEL = replace(spatial(RIG), convention=Convention.ON_TOOL)
SAMPLES = 60
PINOCCHIO_ORDER = [6, 7, 8, 9, 10, 11, 13, 12, 14, 15]
"""Where m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz stand among the 16 parameters."""


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    assert RIG.limits is not None
    series = FreeSeries(joints=6, harmonics=(1, 2, 3), period=5.0)
    return random_feasible_trajectory(
        series, RIG.limits, workspace=RIG.workspace, arm=RIG.arm, tip_length=RIG.tip_length, seed=1
    )


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return Experiment.of(MODEL, RIG.arm)


@pytest.fixture(scope="module")
def reference(motion: Trajectory) -> Array:
    """M (16, 16) by Pinocchio: its regressor of a body on the sensor frame that accelerates against gravity."""
    model = pinocchio.buildModelFromUrdf(str(URDF / "elbow.urdf"))
    data, frame = model.createData(), model.getFrameId("tool0")
    total = np.zeros((16, 16))
    for q, dq, ddq in zip(*motion.evaluate(motion.series.instants(SAMPLES)), strict=True):
        pinocchio.forwardKinematics(model, data, *(np.append(x, [0.0, 0.0]) for x in (q, dq, ddq)))
        pinocchio.updateFramePlacements(model, data)
        velocity = pinocchio.getFrameVelocity(model, data, frame, pinocchio.LOCAL)
        acceleration = pinocchio.getFrameAcceleration(model, data, frame, pinocchio.LOCAL)
        acceleration.linear += data.oMf[frame].rotation.T @ np.array([0.0, 0.0, MODEL.gravity])
        columns = np.hstack([np.eye(6), np.zeros((6, 10))])
        columns[:, PINOCCHIO_ORDER] = pinocchio.bodyRegressor(velocity, acceleration)
        total += columns.T @ columns
    return total


def test_information_is_pinocchios(experiment: Experiment, motion: Trajectory, reference: Array) -> None:
    information = experiment.information(motion, SAMPLES)
    np.testing.assert_allclose(information, reference, atol=1e-12 * np.abs(reference).max())  # rounding of 60 sums
    assert np.linalg.matrix_rank(information) == 16
    assert DOptimal().value(information) == pytest.approx(np.linalg.slogdet(reference)[1], abs=1e-6)


def test_graph_for_the_optimiser_is_the_same_and_has_its_derivative(
    experiment: Experiment, motion: Trajectory, reference: Array
) -> None:
    """The gradient by the states against a central difference in a random direction."""
    states = ca.MX.sym("x", 18, SAMPLES)
    value = DOptimal().graph(experiment.graph(states, motion.period))
    function = ca.Function("value", [states], [value, ca.gradient(value, states)])
    at = np.hstack(motion.evaluate(motion.series.instants(SAMPLES))).T
    found, gradient = (np.array(part) for part in function(at))
    assert found.item() == pytest.approx(np.linalg.slogdet(reference)[1], abs=1e-6)
    direction = np.random.default_rng(0).normal(size=at.shape)
    # h²/6 of a third derivative: the logarithm of a sum over 60 samples of products of sines, about 1e4.
    h = 1e-5
    ahead, behind = (float(function(at + step * direction)[0]) for step in (h, -h))
    assert (ahead - behind) / (2 * h) == pytest.approx(np.sum(gradient * direction), rel=1e-5)


def test_a_motion_within_the_urdfs_limits_and_the_workspace(motion: Trajectory) -> None:
    """What `random_feasible_trajectory` says of the limits that the rig and the URDF share, on a dense grid."""
    assert RIG.limits is not None
    assert RIG.arm is not None
    assert RIG.tip_length is not None
    use = LimitUse.of(motion, RIG.limits, RIG.workspace, RIG.arm, RIG.tip_length)
    assert use.worst.use <= 1.0
    q, dq, _ = motion.evaluate(np.linspace(0.0, motion.period, 2000))
    assert (np.abs(dq) <= [2.2, 2.0, 2.6, 4.0, 4.0, 6.0]).all()
    tip = np.array(RIG.arm.tip(RIG.tip_length)(q.T))
    reached = {reach.name: reach for reach in use.limited_quantities if reach.quantity == "workspace"}
    for name, place in (("x", tip[0]), ("z", tip[2])):
        assert reached[name].low <= place.min()
        assert place.max() <= reached[name].high
        assert place.min() - reached[name].low < 0.01  # tight too


def test_model_and_arm_are_of_one_space() -> None:
    with pytest.raises(InputError, match="planar model came with a spatial arm"):
        Experiment.of(planar(), RIG.arm)
