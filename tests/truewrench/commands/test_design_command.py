"""`truewrench design`: what it prints and writes, and one line for whatever it cannot use."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from design.trajectories.fourier import random_periodic_trajectory
from modeling.chain.model import planar
from modeling.chain.prediction import compiled_prediction
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Rig
from tests.shared.rigs import RIG, spatial_arm
from truewrench.command_line import main
from truewrench.commands.design import simulated_repeat

RIG_TEXT = """
[robot]
link_lengths = [1.0, 0.97, 0.4]
tip_length = 0.2
[limits]
position = [1.05, 1.22, 1.40]
velocity = [2.0, [-2.2, 1.8], 3.5]
acceleration = [10, 10, 15]
[workspace]
y = [0.4, 2.6]
[sensor]
noise = { fx = 0.8, fy = 1.6, tau = 0.08 }
"""
SHORT = """
[robot]
link_lengths = [0.8]
[limits]
position = [1.0]
velocity = [2.0]
acceleration = [10]
"""
QUICK = ("--series", "paper", "--starts", "1", "--no-bound")
WORKSPACE = """[workspace]
y = [0.4, 2.6]
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG_TEXT)
    return path


@pytest.fixture
def joint_limits(rig: Path) -> Path:
    """The same rig without its workspace."""
    rig.write_text(RIG_TEXT.replace(WORKSPACE, ""))
    return rig


def ran(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main([str(a) for a in ("design", *arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def keys(data: dict[str, Any]) -> set[str]:
    return set(data)


def test_json_and_plan_are_what_formats_says(rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "folder" / "plan.csv"
    code, text, error = ran(capsys, rig, *QUICK, "--samples", 120, "--period", 6, "--out", out, "--json")
    assert (code, error) == (0, "")
    data = json.loads(text)
    stated = {"logdet", "samples", "period", "bound_logdet", "bound_kind", "efficiency", "worst_limit_use"}
    assert keys(data) >= stated | {"evaluations"}
    assert (data["samples"], data["period"], data["bound_logdet"], data["efficiency"]) == (120, 6.0, None, None)
    assert keys(data["worst_limit_use"]) == {"position", "velocity", "acceleration", "workspace"}
    assert 0.99 < max(data["worst_limit_use"].values()) <= 1
    plan = pd.read_csv(out)
    assert list(plan.columns) == ["time", *(f"{p}{j}" for p in ("q", "dq", "ddq") for j in (1, 2, 3))]
    assert len(plan) == 120
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert logdet_of(plan) == pytest.approx(data["logdet"], abs=1e-6)  # twelve digits in the file


def interrupted_at(
    rig: Path, out: Path, options: tuple[str, ...], stage: str, ending: signal.Signals
) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command whose processes all get a signal, as of a terminal or `timeout`.

    It is sent once a start of a stage is done, at which a line of the progress is waited for, and once more by somebody
    who does not wait. The pipes end with the last process that holds them: with one that is left, this does not return.
    """
    program = "import sys; from truewrench.command_line import main; sys.exit(main())"
    command = [sys.executable, "-W", "default", "-c", program, "design", str(rig), *options, "--out", str(out)]
    with subprocess.Popen(
        [*command, "--json", "--progress"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        before = ""
        while stage not in before:
            before += process.stderr.readline()
            assert process.poll() is None, before
        os.killpg(process.pid, ending)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=1.0)
        if process.returncode is None:
            os.killpg(process.pid, ending)
        text, error = process.communicate(timeout=120)
    return process.returncode, text, before + error


@pytest.mark.long(25)
@pytest.mark.parametrize(
    ("workers", "ending", "code"), [("2", signal.SIGINT, 130), ("2", signal.SIGTERM, 143), ("1", signal.SIGINT, 130)]
)
def test_interrupted_it_writes_the_best_so_far(
    workers: str, ending: signal.Signals, code: int, joint_limits: Path, tmp_path: Path
) -> None:
    """Nothing of Python's or of the workers on stderr: a traceback, or semaphores that were left."""
    out = tmp_path / "plan.csv"
    options = ("--workers", workers, "--samples", "120")
    found, text, error = interrupted_at(joint_limits, out, options, "all harmonics: 0", ending)
    assert found == code
    said = [line for line in error.splitlines() if " s  " not in line]
    assert len(said) == 1
    assert said[0].startswith("interrupted: this is the best trajectory so far")
    data = json.loads(text)
    assert (data["bound_logdet"], data["efficiency"], data["outcome"]) == (None, None, "interrupted")
    assert max(use for use in data["worst_limit_use"].values() if use is not None) <= 1
    assert logdet_of(pd.read_csv(out)) == pytest.approx(data["logdet"], abs=1e-6)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_what_the_search_found_is_written_whatever_signals_come(
    ending: signal.Signals, joint_limits: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signals that come while the figure is drawn, after a search that ended by itself."""
    from truewrench.plots import trajectory_plot

    drawn, out, before = trajectory_plot.trajectory_figure, tmp_path / "plan.csv", signal.getsignal(ending)

    def interrupted_figure(*given: Any, **options: Any) -> Any:
        os.kill(os.getpid(), ending)
        return drawn(*given, **options)

    monkeypatch.setattr(trajectory_plot, "trajectory_figure", interrupted_figure)
    options = ["--starts", "1", "--harmonics", "2", "--samples", "40", "--no-bound", "--workers", "1"]
    assert main(["design", str(joint_limits), *options, "--out", str(out)]) == 0
    assert len(pd.read_csv(out)) == 40
    assert out.with_suffix(".png").exists()
    assert signal.getsignal(ending) == before


@pytest.mark.long(8)
def test_interrupted_within_the_first_start_it_writes_nothing(rig: Path, tmp_path: Path) -> None:
    """The worker is ended in its first start."""
    out = tmp_path / "plan.csv"
    options = ("--workers", "1", "--no-bound")
    found, text, error = interrupted_at(rig, out, options, "0 of", signal.SIGTERM)
    assert (found, text) == (143, "")
    assert error.splitlines()[-1].startswith("interrupted: no trajectory within the limits was reached yet")
    assert not out.exists()


def logdet_of(plan: pd.DataFrame) -> float:
    """ln det(Phi' Phi) from the file alone, through the derived regressor."""
    arm = PlanarArm((1.0, 0.97, 0.4))
    q, dq, ddq = (plan[[f"{p}{j}" for j in (1, 2, 3)]].to_numpy() for p in ("q", "dq", "ddq"))
    prediction, count = compiled_prediction(planar()), len(plan)
    signals = arm.pose(q, dq, ddq)
    phi = sum(part.tangent(signals, np.zeros(6), count)[1] for part in (prediction.load, prediction.bias))
    rows = np.asarray(phi).reshape(-1, 6)
    return float(np.linalg.slogdet(rows.T @ rows)[1])


@pytest.mark.long
def test_rows_of_the_plan_are_derivatives_of_one_another(
    joint_limits: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out, asked = tmp_path / "plan.csv", ("--series", "rest", "--harmonics", 2, "--starts", 1, "--samples", 401)
    ran(capsys, joint_limits, *asked, "--no-bound", "--out", out)
    plan = pd.read_csv(out)
    step = plan["time"][1]
    for joint in (1, 2, 3):
        slope = np.gradient(plan[f"q{joint}"], step, edge_order=2)
        # Central differences at 80 a second: (w h)² / 6 of 2 rad/s is 8e-3 at 2 Hz, which the ramps come to.
        np.testing.assert_allclose(slope, plan[f"dq{joint}"], atol=2e-2)
        assert plan[f"dq{joint}"].iloc[[0, -1]].abs().max() == 0
        assert plan[f"ddq{joint}"].iloc[[0, -1]].abs().max() == 0


def test_the_text_says_bound_and_efficiency(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    asked = (path, "--harmonics", 6, "--starts", 2, "--workers", 1)
    code, text, _ = ran(capsys, *asked)
    assert code == 0
    for word in ("ln det", "upper bound", "efficiency", "checked", "proven", "periodic", "within the limits"):
        assert word in text
    data = json.loads(ran(capsys, *asked, "--json")[1])
    assert data["logdet"] < data["bound_logdet"]
    assert data["efficiency"] == pytest.approx(np.exp((data["logdet"] - data["bound_logdet"]) / 6))
    assert data["bound_kind"] in ("proven", "checked")


@pytest.mark.parametrize("criterion", ["a", pytest.param("e", marks=pytest.mark.long)])
def test_other_criteria_are_named(joint_limits: Path, capsys: pytest.CaptureFixture[str], criterion: str) -> None:
    text = ran(capsys, joint_limits, *QUICK, "--criterion", criterion)[1]
    assert {"a": "mean variance", "e": "smallest eigenvalue"}[criterion] in text


@pytest.mark.long
def test_seeds_decide(joint_limits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, same, other = (
        json.loads(ran(capsys, joint_limits, *QUICK, "--seed", seed, "--json")[1])["logdet"] for seed in (1, 1, 2)
    )
    assert one == same
    assert one != other


@pytest.mark.long
def test_a_weight_is_taken_from_the_rig(joint_limits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = (joint_limits, *QUICK, "--json")
    plain, weighted = (json.loads(ran(capsys, *asked, *more)[1]) for more in ((), ("--weighted",)))
    assert plain["std"]["bias_fx"] == pytest.approx(1 / np.sqrt(200), rel=0.05)
    assert weighted["std"]["bias_fx"] == pytest.approx(0.8 / np.sqrt(200), rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none.toml",), "none.toml"),
        (("--period", "-1"), "--period"),
        (("--period", "1e300"), "--period"),
        (("--samples", "5"), "samples"),
        (("--series", "rest", "--ramp", "4"), "ramp"),
        (("--model", "none.json"), "none.json"),
        (("--tell", "viscous_drag", "quadratic_drag"), "--model"),
        (("--tell", "viscous_drag", "no_such"), "no_such"),
        (("--tell", "viscous_drag", "com_offset", "--criterion", "a"), "--criterion"),
        (("--seed", "-1"), "--seed"),
        (("--samples", "10000000000"), "--samples"),
        (("--out", "."), "--out"),
        (("--series", "rest", "--play", "plan.script"), "robots with 6 joints, and the arm has 3"),
        (("--out", "plan.png"), "plan.png"),
    ],
)
def test_bad_input_is_one_line(
    rig: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    given = arguments if arguments[0].endswith(".toml") else (rig, *arguments)
    code, text, error = ran(capsys, *given, "--starts", 1, "--no-bound")
    assert (code, text) == (2, "")
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert words in error


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[robot]\nname = 'x'\n", "link_lengths"),
        ("[robot]\nlink_lengths = [1.0, 0.5]\n", "limits"),
        (RIG_TEXT.replace("y = [0.4, 2.6]", "y = [5.0, 6.0]"), "workspace"),
        (RIG_TEXT.replace("[-2.2, 1.8]", "[0.5, 1.8]"), "velocity"),
    ],
)
def test_rigs_without_what_it_takes_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    path, out = tmp_path / "rig.toml", tmp_path / "plan.csv"
    path.write_text(text)
    code, _, error = ran(capsys, path, *QUICK, "--out", out)
    assert code == 2
    assert words in error
    assert not out.exists()


@pytest.mark.long
def test_processes_plan_the_same(joint_limits: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = (joint_limits, "--series", "paper", "--starts", 2, "--no-bound", "--json")
    alone, together = (json.loads(ran(capsys, *short, "--workers", workers)[1]) for workers in (1, 2))
    assert together == alone


def test_a_series_whose_jerk_is_infinite_keeps_no_limit_of_jerk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(SHORT + "jerk = [100]\n")
    steps = ("--series", "spline", "--degree", 2, "--knots", 12, "--starts", 1, "--no-bound")
    code, _, error = ran(capsys, path, *steps)
    assert code == 2
    assert "jerk" in error


@pytest.mark.long
def test_a_far_ceiling_leaves_the_floor_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reached = []
    for ceiling in ("2.7", "1000"):
        path = tmp_path / "rig.toml"
        path.write_text(RIG_TEXT.replace("y = [0.4, 2.6]", f"y = [0.4, {ceiling}]"))
        reached.append(json.loads(ran(capsys, path, *QUICK, "--json")[1])["logdet"])
    assert abs(reached[0] - reached[1]) < 0.5  # other local optima; metres of floor were worth seven nats


@pytest.mark.parametrize("name", ["elbow", "seven", "slide"])
def test_simulated_repeat_is_what_was_planned(name: str) -> None:
    """By MuJoCo's kinematics and inverse dynamics of the chain, on a tilted base."""
    pytest.importorskip("mujoco")
    rig = Rig(spatial_arm=spatial_arm(name), tip_length=0.2, gravity_direction=(0.6, 0.0, -0.8))
    assert rig.arm is not None
    joints = rig.arm.joints
    motion = random_periodic_trajectory(
        joints=joints, position=0.8, velocity=2.0, acceleration=9.0, harmonics=3, period=4.0, seed=1
    )
    said = simulated_repeat(rig, motion, 50)
    assert said is not None
    off, apart = (float(word) for word in re.findall(r"within (\S+) [mN]", said))
    assert off < 1e-12  # rounding
    assert apart < 1e-10
    assert simulated_repeat(RIG, motion, 50) is None  # of a planar arm there is none
