"""Turns between the axes of sensor, logged pose and base, against matrices; derivatives against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.recordings.reading import from_columns
from modeling.chain.model import QUARTER_TURNS, WrenchModel, planar, spatial
from modeling.chain.sensor_axes import (
    Axes,
    axes_data,
    axes_named,
    contact_turn,
    is_turned,
    pose_to_base,
    pose_to_sensor,
    sensor_to_pose,
    turn_words,
)
from modeling.effects import sensor_rotation
from modeling.errors import InputError
from modeling.kinematics.placement import base_angle, base_placement, motion_in_world
from modeling.rig import Convention, Rig
from modeling.space import Space
from tests.shared.rigs import spatial_arm

STEP = 1e-6
"""rad: the second derivative of a rotation is 1, so that a central difference errs by 1e-12, and its rounding 1e-10."""
HALF = replace(spatial(), convention=Convention.ON_SENSOR, mounting=((1, 0, 0), (0, -1, 0), (0, 0, -1)))


def parameters(model: WrenchModel, **values: float) -> np.ndarray:
    return np.array([values.get(p.name.partition(".")[2] or p.name, 0.1) for p in model.parameters])


def test_the_turn_is_the_mounting_and_what_the_effect_turns_beside_it() -> None:
    model = HALF + sensor_rotation()
    theta = parameters(model, roll=0.3, pitch=-0.2, yaw=0.5)
    effect = Rotation.from_euler("xyz", [0.3, -0.2, 0.5])
    turned = np.diag([1.0, -1.0, -1.0]) @ effect.as_matrix()
    assert sensor_to_pose(model, theta) == pytest.approx(turned, abs=1e-15)
    assert sensor_to_pose(model, np.append(theta, 7.0)) == pytest.approx(turned)  # biases of further recordings
    assert is_turned(HALF)
    assert is_turned(spatial() + sensor_rotation())
    assert not is_turned(spatial() + "gravity_tilt")


@pytest.mark.parametrize("model", [HALF + sensor_rotation(), planar() + sensor_rotation()], ids=["six axes", "plane"])
@pytest.mark.parametrize("axes", [Axes.SENSOR, Axes.POSE])
def test_derivatives_of_the_turns_are_those_of_differences(model: WrenchModel, axes: Axes) -> None:
    theta = parameters(model)
    steps = [(theta + d, theta - d) for d in STEP * np.eye(len(theta))]
    for turn in (pose_to_sensor, lambda model, theta: contact_turn(model, theta, axes)):
        differences = [(turn(model, a)[0] - turn(model, b)[0]) / (2 * STEP) for a, b in steps]
        assert turn(model, theta)[1] == pytest.approx(np.stack(differences, axis=-1), abs=1e-9)


@pytest.mark.parametrize("direction", [None, (0.0, 0.0, 1.0), (0.36, -0.48, 0.8)])
def test_base_axes_are_those_in_which_the_pose_was_logged(direction: tuple[float, ...] | None) -> None:
    logged = Rotation.random(5, rng=np.random.default_rng(1))
    signals = dict(zip(("qx", "qy", "qz", "qw"), logged.as_quat().T, strict=True))
    world = signals if direction is None else motion_in_world(signals, direction)
    turn = pose_to_base(Space.SPACE, world, direction)
    for number, matrix in enumerate(logged.as_matrix()):
        assert turn[number] == pytest.approx(np.kron(np.eye(2), matrix), abs=1e-12)
    assert direction is None or base_placement(direction).quaternion != (0.0, 0.0, 0.0, 1.0)


def test_base_axes_of_an_arm_are_those_of_its_first_link() -> None:
    """Whatever the base is mounted on: the joints alone say how the sensor stands in the base."""
    rng, arm = np.random.default_rng(2), spatial_arm("elbow")
    joints = {f"q{i + 1}": rng.uniform(-1, 1, 12) for i in range(arm.joints)}
    columns = joints | {name: rng.normal(size=12) for name in Space.SPACE.channels}
    turns = []
    for direction in (None, (0.36, -0.48, 0.8)):
        recording = from_columns(columns, rig=Rig(spatial_arm=arm, gravity_direction=direction))
        turns.append(pose_to_base(Space.SPACE, recording.signals, direction))
    assert turns[1] == pytest.approx(turns[0], abs=1e-12)


def test_base_axes_of_the_plane() -> None:
    """phi is clockwise from y; x' and y' in base axes are (cos, -sin) and (sin, cos) of the logged angle."""
    phi, direction = np.array([0.0, 0.4, -2.0]), (0.6, -0.8)
    turn = pose_to_base(Space.PLANE, {"phi": phi + base_angle(direction)}, direction)
    for number, angle in enumerate(phi):
        x, y = (np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))
        assert turn[number] @ [2.0, 3.0, 0.5] == pytest.approx([*(2 * np.array(x) + 3 * np.array(y)), 0.5])


def test_every_quarter_turn_is_said_as_what_it_is() -> None:
    """The words hold what turns into the matrix again."""
    for turn in QUARTER_TURNS:
        words = turn_words(np.array(turn, dtype=float))
        if words == "0°":
            assert np.array_equal(turn, np.eye(3))
            continue
        degrees, _, about = words.partition("° about ")
        named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
        sign = -1 if about.startswith("-") else 1
        axis = named.get(about.removeprefix("-")) or tuple(map(float, about.strip("()").split(",")))
        rotation = Rotation.from_rotvec(sign * float(degrees) * np.array(axis) / np.linalg.norm(axis), degrees=True)
        assert rotation.as_matrix() == pytest.approx(np.array(turn), abs=2e-3)
    assert turn_words(Rotation.from_euler("z", 30, degrees=True).as_matrix()) == "30° about z"
    assert turn_words(Rotation.from_euler("z", -30, degrees=True).as_matrix()) == "30° about -z"
    assert turn_words(Rotation.from_euler("x", 179.7, degrees=True).as_matrix()) == "179.7° about x"
    assert turn_words(Rotation.from_euler("x", -179.7, degrees=True).as_matrix()) == "179.7° about x"


def test_axes_have_names() -> None:
    assert axes_named("base") is axes_named(Axes.BASE) is Axes.BASE
    with pytest.raises(InputError, match="give one of sensor, pose, base"):
        axes_named("flange")
    assert axes_data(HALF, parameters(HALF))["tool"] == "pose"
    assert axes_data(spatial(), parameters(spatial()))["tool"] == "sensor"
