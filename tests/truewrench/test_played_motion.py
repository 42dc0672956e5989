"""Motions as robots play them: parsed by other means, they are the design, at rest at both ends, within the limits."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from ruamel.yaml import YAML
from scipy.interpolate import BPoly

from design.trajectories.fourier import FreeSeries
from design.trajectories.spline import RestToRest
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError
from modeling.rig import Limits, Rig
from truewrench.command_line import main
from truewrench.files.played_motion import write_played

Array = NDArray[np.float64]

INNER = FreeSeries(joints=3, harmonics=(1, 2, 3), period=4.0)
SERIES = RestToRest(inner=INNER, ramp=0.6)
NAMES = ["shoulder", "elbow", "wrist"]


def motion(size: float = 0.2) -> Trajectory:
    rng = np.random.default_rng(4)
    return Trajectory(SERIES, size * rng.normal(size=SERIES.size))


def limits(of: Trajectory, spare: float = 1.05) -> Limits:
    """Symmetric ones, so much beyond what the motion reaches on a fine grid."""
    time = np.linspace(0, 4.0, 4001)
    largest = [spare * np.abs(series).max(axis=0) for series in of.evaluate(time)]
    position, velocity, acceleration = (np.column_stack([-reach, reach]) for reach in largest)
    return Limits(position=position, velocity=velocity, acceleration=acceleration)


def test_a_joint_trajectory_is_the_design_for_a_controller_with_quintic_splines(tmp_path: Path) -> None:
    path, plan = tmp_path / "plan.yaml", motion()
    said = write_played(plan, path, limits(plan), NAMES, samples=81)
    message = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    assert list(message) == ["joint_names", "points"]
    assert message["joint_names"] == NAMES
    stamps = [point["time_from_start"] for point in message["points"]]
    time = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    np.testing.assert_allclose(time, np.linspace(0, 4.0, 81), rtol=0, atol=1e-9)
    series = [[point[key] for point in message["points"]] for key in ("positions", "velocities", "accelerations")]
    for given, designed in zip(series, plan.evaluate(time), strict=True):
        np.testing.assert_allclose(given, designed, rtol=0, atol=1e-9)
    fine = np.linspace(0, 4.0, 2001)
    spline = np.stack([BPoly.from_derivatives(time, np.stack(series, axis=1)[:, :, j])(fine) for j in range(3)], axis=1)
    deviation = np.abs(spline - plan.evaluate(fine)[0]).max()
    stated = float(re.search(r"at most (\S+) rad", said)[1])  # type: ignore[index]
    assert stated == pytest.approx(deviation, rel=0.1)


@pytest.mark.parametrize(("suffix", "rate"), [(".script", 500.0), (".csv", 1000.0)])
def test_a_controller_of_a_fixed_rate_gets_a_position_in_every_cycle(suffix: str, rate: float, tmp_path: Path) -> None:
    path, plan = tmp_path / f"plan{suffix}", motion()
    write_played(plan, path, limits(plan), NAMES, samples=81)
    text = path.read_text(encoding="utf-8")
    if suffix == ".csv":
        rows = np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]
    else:
        assert text.startswith("def truewrench_motion():\n")
        assert text.endswith("end\n")
        rows = np.array([row.split(",") for row in re.findall(r"\(\[(.*?)\]", text)], dtype=float)
        assert text.count(f"t={1 / rate:g})") == len(rows) - 1
    np.testing.assert_allclose(rows, plan.evaluate(np.arange(len(rows)) / rate)[0], rtol=0, atol=1e-9)
    assert (len(rows) - 1) / rate == 4.0
    speeds = np.diff(rows, axis=0)[[0, -1]] * rate
    assert np.abs(speeds).max() < 1e-3


def test_what_does_not_rest_at_its_ends_or_exceeds_a_limit_is_refused(tmp_path: Path) -> None:
    plan = motion()
    moving = Trajectory(INNER, np.random.default_rng(1).normal(size=INNER.size))
    with pytest.raises(
        InputError, match=r"starts or ends at .* rad/s, and a robot at rest; design it with --series rest"
    ):
        write_played(moving, tmp_path / "plan.yaml", limits(moving), NAMES, samples=81)
    with pytest.raises(InputError, match=r"would use .* of the .* limits"):
        write_played(plan, tmp_path / "plan.yaml", limits(plan, spare=0.9), NAMES, samples=81)
    with pytest.raises(InputError, match=r"give --play a name with \.yaml"):
        write_played(plan, tmp_path / "plan.txt", limits(plan), NAMES, samples=81)
    assert not list(tmp_path.iterdir())


TWO_JOINTS = """
<robot name="two"><link name="base"/>
<link name="car"><inertial><mass value="1.5"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="0.5"/></inertial></link><link name="tip"/>
<joint name="s" type="prismatic"><parent link="base"/><child link="car"/><axis xyz="1 0 0"/></joint>
<joint name="p" type="revolute"><parent link="car"/><child link="arm"/><axis xyz="0 -1 0"/></joint>
<joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>
</robot>
"""


@pytest.mark.parametrize("suffix", [".yaml", ".csv"])
def test_jerk_torque_and_workspace_of_what_is_written_are_checked(suffix: str, tmp_path: Path) -> None:
    """Of a mass on an arm on a car, whose largest values on a fine grid are those of the file."""
    series = RestToRest(inner=FreeSeries(joints=2, harmonics=(1, 2), period=4.0), ramp=1.0)
    plan = Trajectory(series, 0.3 * np.random.default_rng(2).normal(size=series.size))
    urdf, fine = tmp_path / "two.urdf", np.linspace(0, 4.0, 8001)
    urdf.write_text(TWO_JOINTS, encoding="utf-8")
    names = ("position", "velocity", "acceleration", "jerk")
    largest = {name: np.abs(plan.derivative(fine, order)).max(axis=0) for order, name in enumerate(names)}
    q, dq, ddq = plan.evaluate(fine)
    force = 2.0 * ddq[:, 0] - 0.25 * (ddq[:, 1] * np.sin(q[:, 1]) + dq[:, 1] ** 2 * np.cos(q[:, 1]))
    largest |= {"torque": np.array([np.abs(force).max(), 99.0]), "workspace": 0.5 * np.abs(np.sin(q[:, 1])).max()}

    def played(limited: str, share: float) -> str:
        given = {name: ((share if name == limited else 1.5) * most).tolist() for name, most in largest.items()}
        height = given.pop("workspace")
        robot = {"urdf": str(urdf), "sensor_frame": "tip", "tip_length": 1e-9}
        rig = Rig.from_data({"robot": robot, "limits": given, "workspace": {"z": [-height, height]}})
        assert rig.limits is not None
        return write_played(plan, tmp_path / f"plan{suffix}", rig.limits, ["s", "p"], samples=201, rig=rig)

    for name in ("jerk", "torque", "workspace"):
        assert re.search(rf" m or rad from the design, and uses 99\.[45]% of the {name} limits", played(name, 1.0055))
        with pytest.raises(InputError, match=rf"would use 100\.[56]% of the {name} limits"):
            played(name, 0.9945)


RIG = """
[robot]
link_lengths = [1.0, 0.97, 0.4]
[limits]
position = [1.05, 1.22, 1.4]
velocity = [2.0, 2.2, 3.5]
acceleration = [10, 10, 15]
"""


@pytest.mark.long(seconds=4)
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG, encoding="utf-8")
    short = ["--harmonics", "2", "--starts", "1", "--no-bound", "--workers", "1", "--samples", "101"]
    plan, played = tmp_path / "plan.csv", tmp_path / "plan.yaml"
    assert main(["design", str(rig), *short, "--play", str(played)]) == 2
    assert capsys.readouterr().err.endswith("and --series free in motion; add --series rest\n")
    assert main(["design", str(rig), *short, "--series", "rest", "--out", str(plan), "--play", str(played)]) == 0
    said = capsys.readouterr()
    assert "plan.yaml: ROS 2 JointTrajectory, 101 points" in said.err
    assert str(played) in said.out
    message = YAML(typ="safe").load(played.read_text(encoding="utf-8"))
    assert message["joint_names"] == ["q1", "q2", "q3"]
    rows = np.loadtxt(plan, delimiter=",", skiprows=1)
    np.testing.assert_allclose([point["positions"] for point in message["points"]], rows[:, 1:4], rtol=0, atol=1e-8)
