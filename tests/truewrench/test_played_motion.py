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
from modeling.rig import Limits
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
