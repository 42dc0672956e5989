"""The six-axis regressor against Pinocchio's and against MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest
import sympy as sp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modeling.chain.model import spatial
from modeling.chain.regressor import regressor
from modeling.compiled.symbolic_vector import numpy_function
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.rigs import FULL_INERTIA

Array = NDArray[np.float64]

MODEL = replace(spatial(), convention=Convention.ON_TOOL)
ORDER = ["m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"]
PINOCCHIO_ORDER = ["m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]
UP = np.array([0.0, 0.0, 9.806])
STATES = 200
INPUTS = ["qx", "qy", "qz", "qw", "wx", "wy", "wz", "alx", "aly", "alz", "apx", "apy", "apz"]


@pytest.fixture(scope="module")
def states() -> tuple[Rotation, Array, Array, Array]:
    """Random orientations; omega and alpha in the sensor frame; acceleration of the sensor origin in the world."""
    rng = np.random.default_rng(0)
    turn = Rotation.random(STATES, rng=rng)
    return turn, rng.normal(0, 4, (STATES, 3)), rng.normal(0, 20, (STATES, 3)), rng.normal(0, 10, (STATES, 3))


@pytest.fixture(scope="module")
def phi(states: tuple[Rotation, Array, Array, Array]) -> Array:
    """Our regressor at these states, (N, 6, 16)."""
    function: Callable[..., list[Any]] = numpy_function(sp.symbols(INPUTS, real=True), list(regressor(MODEL)))
    turn, omega, alpha, acceleration = states
    values = function(*turn.as_quat().T, *omega.T, *alpha.T, *acceleration.T)
    return np.stack([np.broadcast_to(v, STATES) for v in values], axis=1).reshape(STATES, 6, 16)


def test_parameters_are_in_the_agreed_order() -> None:
    biases = [f"bias_{channel}" for channel in ("fx", "fy", "fz", "tx", "ty", "tz")]
    assert [p.name for p in MODEL.parameters] == biases + ORDER


def test_regressor_is_pinocchios(states: tuple[Rotation, Array, Array, Array], phi: Array) -> None:
    """Pinocchio takes spatial accelerations: the classical one less omega x v, whatever the velocity v is."""
    velocity = np.random.default_rng(1).normal(0, 3, (STATES, 3))
    columns = [6 + ORDER.index(name) for name in PINOCCHIO_ORDER]
    for i, (turn, omega, alpha, acceleration) in enumerate(zip(*states, strict=True)):
        lift = turn.apply(acceleration + UP, inverse=True)
        motion = pinocchio.Motion(velocity[i], omega)
        rate = pinocchio.Motion(lift - np.cross(omega, velocity[i]), alpha)
        # rounding of sums of terms up to 200
        np.testing.assert_allclose(phi[i][:, columns], pinocchio.bodyRegressor(motion, rate), atol=1e-10)


def test_biases_are_added_to_their_channels(phi: Array) -> None:
    np.testing.assert_array_equal(phi[:, :, :6], np.broadcast_to(np.eye(6), (STATES, 6, 6)))


def test_on_sensor_turns_the_wrench_round_and_not_the_bias() -> None:
    sensor = SensorDescription(convention=Convention.ON_SENSOR)
    ours, theirs = regressor(MODEL), regressor(spatial(Rig(sensor=sensor)))
    assert theirs[:, :6] == ours[:, :6] == sp.eye(6)
    assert sp.expand(theirs[:, 6:] + ours[:, 6:]) == sp.zeros(6, 10)
    assert ours[:, 6:] != sp.zeros(6, 10)


def test_a_hanging_weight_reads_plus_its_weight_on_the_sensor() -> None:
    """FORMATS: on_sensor, a hanging weight reads +m g. The sensor's z points down, the tool hangs below."""
    half_turn = dict(zip(INPUTS, [1.0, *[0.0] * 12], strict=True))  # about x
    model = spatial(Rig(sensor=SensorDescription(convention=Convention.ON_SENSOR)))
    values = {sp.Symbol(name, real=True): value for name, value in half_turn.items()}
    assert float(regressor(model).subs(values)[2, 6]) == pytest.approx(9.806, rel=1e-15)


def test_wrench_is_mujocos(states: tuple[Rotation, Array, Array, Array], phi: Array) -> None:
    """A free body that carries the tool: MuJoCo's velocities are the world's for the origin, the body's for turning."""
    rng = np.random.default_rng(2)
    mass, centre, spread = 1.3, rng.normal(0, 0.1, 3), rng.normal(0, 0.1, (5, 3))
    # A cloud of five equal particles about the centre gives an inertia that is a body's.
    about_centre = sum(mass / 5 * (p @ p * np.eye(3) - np.outer(p, p)) for p in spread - spread.mean(axis=0))
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    theta = np.array([*rng.normal(0, 5, 6), mass, *(mass * centre), *inertia[np.triu_indices(3)]])
    six = about_centre[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    def text(values: Array) -> str:
        return " ".join(repr(float(v)) for v in values)

    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="{text(-UP)}"/><worldbody><body><freejoint/>'
        '<inertial pos="0.1 0 0" mass="2" diaginertia="1 1 1"/>'
        f'<body><inertial pos="{text(centre)}" mass="{mass}" fullinertia="{text(six)}"/><site name="s"/></body>'
        '</body></worldbody><sensor><force site="s"/><torque site="s"/></sensor></mujoco>'
    )
    data = mujoco.MjData(model)
    felt = []
    for turn, omega, alpha, acceleration in zip(*states, strict=True):
        data.qpos[3:] = turn.as_quat(scalar_first=True)
        data.qvel[3:] = omega
        data.qacc[:3], data.qacc[3:] = acceleration, alpha
        mujoco.mj_inverse(model, data)
        felt.append(data.sensordata.copy())
    np.testing.assert_allclose(phi @ theta, np.array(felt) + theta[:6], atol=FULL_INERTIA)
