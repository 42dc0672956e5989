"""Gravity or an accelerometer instead of a pose: the same tool as by the pose, and refusals that say what to log."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimation.fit import fit
from estimation.reading.gravity_vector import level_quaternions
from estimation.reading.log_reader import Array
from estimation.reading.log_reading import imported, read
from modeling.chain.model import spatial
from modeling.errors import InputError
from tests.shared.log_files import CHANNELS, QUATERNION
from tests.shared.recordings import recording_of
from truewrench.simulated_rig import SpatialRig, simulate, static_poses

pytest.importorskip("mujoco")

RIG = SpatialRig()
GRAVITY = 9.806
XYZ = "xyz"


@cache
def poses() -> pd.DataFrame:
    return static_poses(RIG, 24, seed=3)


@cache
def run() -> pd.DataFrame:
    motion = RIG.random_motion(seed=3, period=10.0)
    return simulate(RIG, motion, repeats=1, samples_per_period=2500, seed=5).drop(columns=["repeat", "temperature"])


@cache
def inertial() -> tuple[Array, Array]:
    """Specific force, m/s², and angular velocity, rad/s, (n, 3) of the run, with an IMU's noise."""
    rng, signals = np.random.default_rng(1), recording_of(run()).signals
    acceleration, rate = (np.stack([signals[prefix + axis] for axis in XYZ], axis=1) for prefix in ("ap", "w"))
    turn = Rotation.from_quat(np.stack([signals[name] for name in QUATERNION], axis=1))
    force = turn.apply(acceleration + np.array([0.0, 0.0, GRAVITY]), inverse=True)
    return force + rng.normal(0, 0.05, force.shape), rate + rng.normal(0, 0.005, rate.shape)


def gravity_of_poses() -> Array:
    """Down in the sensor's axes (n, 3), m/s²."""
    turn = Rotation.from_quat(poses()[QUATERNION].to_numpy(copy=True))
    down = turn.apply([0.0, 0.0, -GRAVITY], inverse=True)
    return down + np.random.default_rng(0).normal(0, 0.01, down.shape)


def written(path: Path, names: list[str], vectors: Array, frame: pd.DataFrame) -> Path:
    pd.DataFrame(vectors, columns=names).join(frame).to_csv(path, index=False)
    return path


STATIC = {
    "gravity": (["gx", "gy", "gz"], 1.0),
    "gravity in g": (["gravity.x", "gravity.y", "gravity.z"], 1 / GRAVITY),
    "accelerometer": ([f"imu/linear_acceleration/{axis}" for axis in XYZ], -1.0),
    "accelerometer in g": ([f"a{axis} [g]" for axis in XYZ], -1 / GRAVITY),
    "accelerometer in mg": ([f"acc_{axis}" for axis in XYZ], -1000 / GRAVITY),
}


@pytest.mark.parametrize("source", STATIC)
def test_a_vector_at_rest_gives_the_tool_of_the_poses(source: str, tmp_path: Path) -> None:
    """Mass and centre within 1 % of 1.2 kg and 1 mm: the vector errs by 1 mrad in each of 24 poses."""
    names, factor = STATIC[source]
    path = written(tmp_path / "log.csv", names, factor * gravity_of_poses(), poses()[CHANNELS])
    recording = imported(path).recording()
    assert recording.at_rest
    assert "apz" not in recording.columns
    tool, truth = (fit(spatial(), r).values for r in (recording, recording_of(poses())))
    assert tool["m"] == pytest.approx(truth["m"], rel=0.01)
    for moment in ("mx", "my", "mz"):
        assert tool[moment] == pytest.approx(truth[moment], abs=1.2e-3)


def test_the_file_of_a_calibration_package_is_read(tmp_path: Path) -> None:
    """Two comment lines, the second one the names in brackets; spaces between the numbers."""
    path = tmp_path / "measurements.txt"
    rows = np.hstack([gravity_of_poses(), poses()[CHANNELS].to_numpy()])
    head = "% gravity , f/t measurements all expressed in F/T sensor frame\n% [gx, gy, gz, fx, fy, fz, tx, ty, tz]\n"
    path.write_text(head + "\n".join(" ".join(f"{number:.6g}" for number in row) for row in rows))
    assert fit(spatial(), read(path)).values["m"] == pytest.approx(1.2, rel=0.01)


@pytest.mark.parametrize(
    ("force", "rate"), [(1.0, 1.0), (1 / GRAVITY, 180 / np.pi)], ids=["m/s² and rad/s", "g and degrees per second"]
)
@pytest.mark.parametrize(
    "letters", [("acc_", "gyro_"), ("a", "g"), ("imu.linear_acceleration.", "imu.angular_velocity.")]
)
def test_an_accelerometer_with_a_gyroscope_serves_for_a_pose(
    letters: tuple[str, str], force: float, rate: float, tmp_path: Path
) -> None:
    """Mass to 0.1 % and centre to 0.1 mm, as by the pose; units are told by the data."""
    names = [letter + axis for letter in letters for axis in XYZ]
    vectors = np.hstack([force * inertial()[0], rate * inertial()[1]])
    recording = read(written(tmp_path / "log.csv", names, vectors, run()[["time", *CHANNELS]]))
    assert recording.reading is not None
    assert [assumption.value for assumption in recording.reading.assumptions] == (["deg/s"] if rate > 1 else [])
    tool = fit(spatial(), recording).values
    assert tool["m"] == pytest.approx(1.2, rel=1e-3)
    truth = fit(spatial(), recording_of(run())).values
    for moment in ("mx", "my", "mz"):
        assert tool[moment] == pytest.approx(truth[moment], abs=1.2e-4)
    assert tool["Izz"] == pytest.approx(truth["Izz"], rel=0.02)


def test_an_accelerometer_alone_is_refused_in_a_fast_motion(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", ["ax", "ay", "az"], inertial()[0], run()[["time", *CHANNELS]])
    with pytest.raises(InputError, match=r"nothing tells the turn about it; log a gyroscope"):
        read(path)


def test_a_vector_of_another_length_is_asked_for(tmp_path: Path) -> None:
    names, vectors = ["acc_x", "acc_y", "acc_z"], 3.3 * gravity_of_poses()
    path = written(tmp_path / "log.csv", names, vectors, poses()[CHANNELS])
    with pytest.raises(InputError, match=r"median length of 32.*neither 9.8 m/s² nor 1 g.*acceleration"):
        imported(path)


def test_a_pose_comes_before_an_accelerometer(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", ["acc_x", "acc_y", "acc_z"], inertial()[0], run())
    assert "wx" not in imported(path).columns
    np.testing.assert_array_equal(imported(path).columns["qx"], run()["qx"])


def test_a_map_states_what_a_vector_is(tmp_path: Path) -> None:
    """An accelerometer under names that mean nothing."""
    path = written(tmp_path / "log.csv", ["a1", "b2", "c3"], -gravity_of_poses(), poses()[CHANNELS])
    stated = tmp_path / "map.toml"
    stated.write_text('orientation = "accelerometer"\norientation_columns = ["a1", "b2", "c3"]\n')
    assert fit(spatial(), imported(path, map=stated).recording()).values["m"] == pytest.approx(1.2, rel=0.01)


def test_every_direction_is_brought_upwards_by_small_turns() -> None:
    rng = np.random.default_rng(0)
    up = rng.normal(size=(1001, 3))
    up[500] = -up[499]
    unit = up / np.linalg.norm(up, axis=1, keepdims=True)
    assert np.abs(Rotation.from_quat(level_quaternions(up)).apply(unit) - [0, 0, 1]).max() < 1e-12
    angle = np.linspace(0, 9, 500)
    smooth = np.stack([np.cos(angle), np.full(500, 0.1), np.sin(angle)], axis=1)  # through the opposite of up
    turns = Rotation.from_quat(level_quaternions(smooth))
    assert (turns[:-1].inv() * turns[1:]).magnitude().max() < 1.01 * 9 / 499
