"""Repeats whose motion differs: each is predicted with its own motion, by recordings of the simulated rig.

The simulator knows nothing of repeats here: the whole record is one period of a motion that nearly repeats.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

import truewrench as tw
from benchmarks.robot_motions import NearlyRepeated
from estimation.case import Case, prepared
from estimation.model_response import model_response
from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import difference_of, is_separated
from modeling.errors import InputError
from modeling.significance import LEVELS
from tests.shared.rigs import ARM_RIG, ARM_TEXT
from truewrench.command_line import main
from truewrench.simulated_rig import HiddenEffect, PlanarRig, SpatialRig, TimeDelay, ViscousDrag, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
REPEATS, SAMPLES, PERIOD = 8, 300, 4.0
FLOOR_TOLERANCE = 0.06
"""Of a std from 2100 differences: nearly four standard errors of 1.5 %."""


def nearly_repeated(
    rig: PlanarRig | SpatialRig, size: float, *, seed: int = 1, hidden: tuple[HiddenEffect, ...] = ()
) -> pd.DataFrame:
    motion = NearlyRepeated(rig, size, seed, PERIOD, REPEATS)
    frame = simulate(rig, motion, hidden=hidden, repeats=1, samples_per_period=REPEATS * SAMPLES, seed=seed)
    return frame.assign(repeat=np.arange(len(frame)) // SAMPLES)


def recorded(frame: pd.DataFrame, rig: PlanarRig | SpatialRig) -> Recording:
    return tw.from_dataframe(frame, rig=ARM_RIG if isinstance(rig, PlanarRig) else None)


def model_of(rig: PlanarRig | SpatialRig) -> tw.WrenchModel:
    return tw.planar(ARM_RIG) if isinstance(rig, PlanarRig) else tw.spatial()


# ------------------------------------------------------------------------------------- prediction


@pytest.mark.parametrize(
    ("rig", "separate"),
    [
        pytest.param(SpatialRig(), False, id="six axes, without pause"),
        pytest.param(PlanarRig(), True, id="planar, one by one"),
        pytest.param(SpatialRig(), True, id="six axes, one by one", marks=pytest.mark.long),
        pytest.param(PlanarRig(), False, id="planar, without pause", marks=pytest.mark.long),
    ],
)
def test_noise_is_what_remains_after_the_motion(rig: PlanarRig | SpatialRig, separate: bool) -> None:
    frame = nearly_repeated(rig, 3e-3)
    if separate:
        frame["time"] = np.tile(frame["time"][:SAMPLES], REPEATS)
    recording = recorded(frame, rig)
    assert recording.continuous is not separate
    fit = tw.fit(model_of(rig), recording)
    np.testing.assert_allclose(fit.noise[0].floor, rig.noise, rtol=FLOOR_TOLERANCE)
    between = recording.wrench - recording.averaged(recording.wrench)
    assert (between.std(axis=0) > 1.5 * np.array(rig.noise)).any()  # the mean motion would leave all of this
    assert tw.compare(fit).lack_of_fit > 0.001  # one of a thousand fails by chance
    mass = fit.parameters["m"]
    assert abs(mass.value - rig.mass) < 4 * mass.std
    problem, elsewhere = fit.problem, 1.1 * fit.theta
    assert problem.chi_square(elsewhere) == pytest.approx(problem.information(elsewhere).cost, rel=1e-9)


@pytest.mark.long
def test_drag_is_found_alone_and_no_tone() -> None:
    rig = PlanarRig()
    recording = recorded(nearly_repeated(rig, 3e-3, hidden=(ViscousDrag(),)), rig)
    candidates = [tw.effects.named(name) for name in ("viscous_drag", "line_interference", "sensor_lag")]
    found = tw.diagnose(model_of(rig), recording, effects=candidates)
    assert (found.verdict.value, found.added) == ("explained", ("viscous_drag",))
    np.testing.assert_allclose(found.fit.noise[0].floor, rig.noise, rtol=FLOOR_TOLERANCE)
    drag = found.fit.parameters["viscous_drag.c"]
    assert abs(drag.value - 0.15) < 4 * drag.std


def test_a_sensor_that_turns_round_in_every_repeat() -> None:
    """The quaternion changes sign from one repeat to the next, and its difference does not."""
    time = np.arange(REPEATS * SAMPLES) * (PERIOD / SAMPLES)
    added = 2e-3 * np.sin(2 * np.pi * 5 * time / (PERIOD * REPEATS) + 1)
    angle = 2 * np.pi * time / PERIOD + 0.1 * np.sin(2 * np.pi * time / PERIOD)
    half = (angle + added) / 2
    columns: dict[str, Any] = {
        "time": time,
        "repeat": np.arange(len(time)) // SAMPLES,
        "qx": np.sin(half),
        "qy": 0 * half,
    }
    columns |= {"qz": 0 * half, "qw": np.cos(half)}
    wrench = np.random.default_rng(1).standard_normal((len(time), 6))
    own = tw.from_arrays(wrench, **columns).own_motion
    assert own is not None
    rate = np.gradient(angle + added, time)
    inner = slice(10, -10)
    np.testing.assert_allclose(own.signals["wx"][inner], rate[inner], atol=1e-4)  # a hundredth of what is added


# ------------------------------------------------------------------------------- equal repeats


def test_equal_repeats_have_the_mean_motion_alone() -> None:
    """With white noise of the encoders ten times the resolver's step; a false alarm has 1 % by simulation."""
    frame = simulate(PlanarRig(), PlanarRig().random_motion(seed=2), repeats=8, samples_per_period=300, seed=2)
    noise = np.random.default_rng(2).standard_normal((len(frame), 3))
    for motion in (frame, frame.assign(**{f"q{j + 1}": frame[f"q{j + 1}"] + 7e-5 * noise[:, j] for j in range(3)})):
        recording = recorded(motion, PlanarRig())
        assert recording.own_motion is None
        model = model_of(PlanarRig())
        assert model_response(model, recording, np.ones(len(model.parameters))).own_motion is None


@pytest.mark.parametrize("step", [1e-5, 1e-4])
def test_slow_noise_of_an_encoder_is_not_taken_for_motion(step: float) -> None:
    """A drifting encoder looks like motion that differs; the readings lack it, or are too noisy for 1e-5 m to show."""
    frame = simulate(SpatialRig(), SpatialRig().random_motion(seed=3), repeats=8, samples_per_period=300, seed=3)
    walk = np.cumsum(np.random.default_rng(3).standard_normal((len(frame), 3)), axis=0)
    names = ["px", "py", "pz"]
    recording = recorded(frame.assign(**{n: frame[n] + step * walk[:, i] for i, n in enumerate(names)}), SpatialRig())
    assert recording.own_motion is not None
    fit = tw.fit(tw.spatial(), recording)
    assert prepared(recording, fit.model).own_motion is None
    np.testing.assert_allclose(fit.noise[0].floor, SpatialRig().noise, rtol=FLOOR_TOLERANCE)


@pytest.mark.parametrize(("repeats", "correlation"), [(2, 0.0), (3, 0.0), (8, 0.0), (8, 0.9)])
def test_an_error_of_the_motion_is_rarely_taken_for_motion(repeats: int, correlation: float) -> None:
    """1 % at the most, at differences of the motion of the worst size: more than 11 of 400 have a chance of 2e-3."""
    rng, samples = np.random.default_rng(repeats), 240 // repeats * repeats
    added = difference_of(rng.standard_normal((samples, 1)) @ np.ones((1, 3)), repeats)
    covariance = (1 - correlation) * np.eye(3) + correlation
    worst = added * np.sqrt(
        LEVELS.separated_by_readings / np.einsum("np,pq,nq", added, np.linalg.inv(covariance), added)
    )
    root = np.linalg.cholesky(covariance).T
    noise = [rng.standard_normal((samples, 3)) @ root for _ in range(400)]
    assert sum(is_separated(worst, readings, repeats) for readings in noise) <= 11
    assert all(is_separated(9 * worst, readings + 9 * worst, repeats) for readings in noise[:40])


NOISES: dict[str, Callable[[Array], Array]] = {
    "random walk": lambda white: np.cumsum(white, axis=0),
    "low-passed": lambda white: lfilter(*butter(4, 0.1), white, axis=0) + 1e-3 * white[::-1],
    "autoregression": lambda white: lfilter([1.0], [1.0, -0.9], white, axis=0),
}


@pytest.mark.parametrize("repeats", [2, pytest.param(8, marks=pytest.mark.long)])
@pytest.mark.parametrize("noise", NOISES)
def test_an_error_of_the_motion_is_rarely_taken_for_motion_in_noise_of_any_colour(noise: str, repeats: int) -> None:
    """Errors of an amplitude, a walk, a creep, each of three sizes.

    1 % of each at the most, whatever the size: more than 8 of 75 with any of the sizes have a chance of 4e-4 if the
    three are independent, and less as they are not.
    """
    rng, samples = np.random.default_rng(repeats), 1200
    time = np.arange(samples) / samples
    wave = np.sin(2 * np.pi * 3 * repeats * time[:, None] + np.arange(3))
    alarms = 0
    for kind in ["amplitude", "walk", "creep"] * 25:
        readings = NOISES[noise](rng.standard_normal((samples + 200, 3)))[200:]
        error = {
            "amplitude": wave * np.repeat(rng.standard_normal(repeats), samples // repeats)[:, None],
            "walk": np.cumsum(rng.standard_normal((samples, 1)), axis=0) * np.ones(3),
            "creep": time[:, None] * wave + rng.standard_normal(3) * time[:, None],
        }[kind]
        sizes = [share * difference_of(readings, repeats).std() / error.std() for share in (0.003, 0.03, 0.3)]
        alarms += any(is_separated(size * error, readings, repeats) for size in sizes)
    assert alarms <= 8


@dataclass(frozen=True)
class Creeping:
    """A motion that repeats but for a creep of `size` rad in every joint over the record of `period` s."""

    size: float
    repeat: float
    period: float

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """States at the times (n,)."""
        q, dq, ddq = PlanarRig().random_motion(seed=4, period=self.repeat).evaluate(time)
        return q + self.size * time[:, None] / self.period, dq + self.size / self.period, ddq


def test_readings_that_are_late_follow_a_motion_that_creeps() -> None:
    """The record does not close: its end is no past of its beginning."""
    rig, hidden = PlanarRig(), TimeDelay(delay=2.5 * PERIOD / SAMPLES)
    motion = Creeping(0.02, PERIOD, REPEATS * PERIOD)
    frame = simulate(rig, motion, hidden=(hidden,), repeats=1, samples_per_period=REPEATS * SAMPLES, seed=4)
    recording = recorded(frame.assign(repeat=np.arange(len(frame)) // SAMPLES), rig)
    model = model_of(rig) + tw.effects.named("time_delay")
    assert prepared(recording, model).own_motion is not None
    fit = tw.fit(model, recording)
    np.testing.assert_allclose(fit.noise[0].floor, rig.noise, rtol=FLOOR_TOLERANCE)
    delay = fit.parameters["time_delay.delay"]
    assert abs(delay.value - hidden.delay) < 4 * delay.std
    assert tw.compare(fit).lack_of_fit > 0.001


def test_a_motion_that_creeps_is_read() -> None:
    """One line in four has all of the difference."""
    time = np.arange(2400) / 2400
    added = difference_of(np.sin(2 * np.pi * time[:, None] + np.arange(3)), 8)
    noise = np.random.default_rng(1).standard_normal((2400, 3))
    assert is_separated(added, added + 0.01 * noise, 8)
    assert not is_separated(added, 0.01 * noise, 8)


def test_a_constant_channel_neither_hinders_nor_decides() -> None:
    rng = np.random.default_rng(5)
    added = difference_of(rng.standard_normal((2400, 3)), 8)
    readings = added + 0.1 * rng.standard_normal((2400, 3))
    for value in (0.0, 0.37):
        readings[:, 2] = value
        assert is_separated(added, readings, 8)
    assert not is_separated(added, np.full((2400, 3), 0.37), 8)


@pytest.mark.parametrize("value", [0.0, 0.37])
def test_a_constant_channel_of_repeats_that_differ_is_named_and_weighs_nothing(value: float) -> None:
    recording = recorded(nearly_repeated(PlanarRig(), 3e-3).assign(tau=value), PlanarRig())
    (reading,) = Case.of(model_of(PlanarRig()), [recording]).readings
    assert reading.id == "channel_constant"
    assert "tau is no reading" in reading.sentence
    fitted = tw.fit(model_of(PlanarRig()), recording)["m"]
    assert abs(fitted.value - PlanarRig().mass) < 3 * fitted.std


# ------------------------------------------------------------------------- repeats that are none


def equal_repeats() -> pd.DataFrame:
    rig = PlanarRig()
    return simulate(rig, rig.random_motion(seed=3, period=PERIOD), repeats=6, samples_per_period=SAMPLES, seed=3)


def test_a_repeat_out_of_phase_is_refused_by_its_number() -> None:
    frame = equal_repeats()
    measured = [name for name in frame if name not in ("time", "repeat")]
    rows = frame["repeat"] == 3
    frame.loc[rows, measured] = np.roll(frame.loc[rows, measured].to_numpy(), 30, axis=0)
    recording = tw.from_dataframe(frame, rig=ARM_RIG)
    assert recording.reading is not None
    (said,) = recording.reading.of(StepKind.SUSPICIOUS)
    assert "the motion of repeat 3" in said.what
    with pytest.raises(InputError, match=r"repeat 3.* it is 0\.4 s late; leave it out"):
        tw.fit(tw.planar(ARM_RIG), recording)


def test_a_pause_and_a_wrong_count_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = equal_repeats()
    paused = np.concatenate([np.arange(1000), np.full(60, 1000), np.arange(1000, len(frame) - 60)])
    wrong = {"paused": frame.iloc[paused].assign(time=frame["time"].to_numpy(), repeat=frame["repeat"].to_numpy())}
    wrong["counted wrongly"] = frame.iloc[: 6 * 270].assign(repeat=np.arange(6 * 270) // 270)
    (tmp_path / "rig.toml").write_text(ARM_TEXT)
    for name, log in wrong.items():
        path = tmp_path / f"{name}.csv"
        log.to_csv(path, index=False)
        assert main(["diagnose", str(path), "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err.strip().splitlines()[-1]
        assert "the motion of repeat" in said
        assert "--no-period" in said
        assert not (tmp_path / "out").exists()
        assert tw.read(path, rig=ARM_RIG, one_run=True).repeats == 1


def test_a_wrong_period_is_said_and_makes_one_run() -> None:
    frame = equal_repeats().drop(columns="repeat")
    recording = tw.from_dataframe(frame, rig=ARM_RIG, period=3.3)
    assert (recording.repeats, recording.samples) == (1, len(frame))
    assert recording.reading is not None
    (said,) = recording.reading.of(StepKind.SUSPICIOUS)
    assert "does not repeat with a period of 3.3 s" in said.what
    assert "one run" in said.what


def test_repeats_that_differ_slightly_are_in_the_reading_report() -> None:
    recording = recorded(nearly_repeated(PlanarRig(), 3e-3), PlanarRig())
    assert recording.reading is not None
    assert "its own motion" in recording.reading.steps[-1].what


# ------------------------------------------------------------------------------------- cutting


def test_frames_and_arrays_are_cut_as_files_are(tmp_path: Path) -> None:
    frame = equal_repeats().drop(columns="repeat")
    rig = ARM_RIG
    path = tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    from_file = tw.read(path, rig=rig)
    assert from_file.repeats == 6
    arrays: dict[str, Any] = {"time": frame["time"], "q": frame[["q1", "q2", "q3"]]}
    wrench = frame[["fx", "fy", "tau"]]
    for recording in (tw.from_dataframe(frame, rig=rig), tw.from_arrays(wrench, rig=rig, **arrays)):
        assert (recording.repeats, recording.samples) == (6, from_file.samples)
        np.testing.assert_allclose(recording.wrench, from_file.wrench, rtol=1e-12)
    assert tw.from_arrays(wrench, rig=rig, one_run=True, **arrays).repeats == 1
    assert tw.from_dataframe(frame, rig=rig, period=8.0).repeats == 3
    unequal = equal_repeats().drop(index=[299]).assign(time=lambda f: np.arange(len(f)) * PERIOD / SAMPLES)
    assert tw.from_dataframe(unequal, rig=rig).repeats >= 5
    poses = equal_repeats().drop(columns=["time", "repeat"]).iloc[::110]
    with pytest.raises(InputError, match="poses at rest have no period"):
        tw.from_dataframe(poses, rig=rig, period=1.0)


def test_fit_and_diagnose_take_the_period(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two turns of the motion are a period too."""
    frame, path, rig = equal_repeats().drop(columns="repeat"), tmp_path / "log.csv", tmp_path / "rig.toml"
    noise = np.random.default_rng(1).standard_normal((len(frame), 3))
    frame[["q1", "q2", "q3"]] += 1e-5 * noise
    frame.to_csv(path, index=False)
    rig.write_text(ARM_TEXT)
    assert main(["fit", str(path), "--rig", str(rig), "--period", "8", "--runs"]) == 0
    (row,) = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("tau") and "±" in line]
    assert row[-2:] == ["3", "3"]  # repeats
    command = ["diagnose", str(path), "--rig", str(rig), "--period", "8", "--only", "viscous_drag", "--json"]
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out)["noise_source"] == "repeats"
    assert main(["fit", str(path), "--rig", str(rig), "--period", "900"]) == 2
    assert "--period" in capsys.readouterr().err
