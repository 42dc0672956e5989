"""Recordings of a six-axis tool whose motion was logged slowly, held, with noise, or without its position.

The simulated rig shares no equation with smoothing or propagation. Each recording has a seed of its own.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.robot_motions import QuinticPath, point_to_point
from benchmarks.single_run import SingleRun
from diagnosis.comparison.comparison import comparison_of
from diagnosis.comparison.slow_residual import inertial_share, orientation_share
from diagnosis.diagnosis import RECORD_RULES, RecordEvidence
from diagnosis.verdict.unexplained_residual import motion_notes, unknown_tool_reason
from diagnosis.verdict_rule import RecordVerdict, judge
from estimation.fit import Fit, fit
from estimation.noise.recording_noise import MotionNoise
from estimation.recordings.motion_limits import motion_limits, world_axes
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import spatial
from modeling.rig import SPATIAL_CHANNELS, Rig
from tests.shared.recordings import recording_of
from truewrench.command_line import main
from truewrench.simulated_rig import (
    CableSpring,
    GravityTilt,
    HiddenEffect,
    Magnet,
    SensorGain,
    SensorLag,
    SensorRotation,
    SpatialRig,
    TimeDelay,
    ViscousDrag,
    simulate,
)
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import tool_text

pytest.importorskip("mujoco")

SIMULATED = SpatialRig()
STATED = Rig.from_data(
    {"sensor": {"noise": dict(zip(("fx", "fy", "fz", "tx", "ty", "tz"), SIMULATED.noise, strict=True))}}
)
ORIENTATION, POSITION = ["qx", "qy", "qz", "qw"], ["px", "py", "pz"]


@cache
def run(samples: int, harmonics: int, seed: int = 1) -> pd.DataFrame:
    motion = SIMULATED.random_motion(seed=seed, period=30.0, harmonics=harmonics)
    return simulate(SIMULATED, motion, repeats=1, samples_per_period=samples, seed=seed + 7).drop(columns="repeat")


def recorded(frame: pd.DataFrame, rig: Rig | None = STATED) -> Recording:
    return recording_of(frame, name="run.csv", rig=rig)


def noisy(frame: pd.DataFrame, radians: float, metres: float, seed: int) -> pd.DataFrame:
    rng, frame = np.random.default_rng(seed), frame.copy()
    turns = Rotation.from_rotvec(radians * rng.standard_normal((len(frame), 3)))
    frame[ORIENTATION] = (Rotation.from_quat(frame[ORIENTATION].to_numpy()) * turns).as_quat()
    frame[POSITION] = frame[POSITION].to_numpy() + metres * rng.standard_normal((len(frame), 3))
    return frame


def consistent(fitted: Fit) -> bool:
    """Whether the residual has the stated noise's size, and the mass is within 4 std."""
    mass = fitted.parameters["m"]
    return comparison_of(fitted, 0).lack_of_fit > 1e-3 and abs(mass.value - SIMULATED.mass) < 4 * mass.std


def test_ten_hertz_carry_a_motion_up_to_two() -> None:
    fitted = fit(spatial(STATED), recorded(run(300, 45)))
    assert consistent(fitted)


def test_encoder_noise_is_noise_and_not_physics() -> None:
    """Errors of the acceleration that are as large as the readings' noise; a tenth of them would be significant."""
    frame = noisy(run(3000, 20), 1e-3, 1e-3, seed=2)
    fitted = fit(spatial(STATED), recorded(frame))
    assert fitted.noise[0].motion is not None
    assert consistent(fitted)


def test_motion_noise_weighs_the_ends_less() -> None:
    fitted = fit(spatial(STATED), recorded(noisy(run(3000, 20), 1e-3, 1e-3, seed=3)))
    motion = fitted.noise[0].motion
    assert motion is not None
    weights = motion.weights(fitted.noise[0].floor, 1)
    assert weights is not None
    assert weights[[0, -1]].max() < 0.5
    assert np.median(weights) > 0.9


def test_an_estimate_is_not_weighted_by_what_was_drawn() -> None:
    """Draws a hundred times as large as all noise, as an inertia that is not shown makes them: of 2000 rows one in a
    thousand weighs less than nine tenths by chance (11 draws of independent rows), and those at the ends weigh less."""
    errors = 100 * np.random.default_rng(0).standard_normal((11, 2000, 6))
    errors[:, :20] *= 10
    weights = MotionNoise(errors=errors, correlation_length=5.0).steady_weights(np.ones(6), 1)
    assert weights is not None
    assert np.mean(weights[25:] < 0.9) < 1e-3
    assert weights[:18].max() < 0.1


@pytest.mark.parametrize("rows", [2, 4])
def test_held_orientation_is_noticed_and_rebuilt(rows: int) -> None:
    frame = run(3000, 20).copy()
    frame[ORIENTATION] = frame[ORIENTATION].to_numpy()[np.arange(3000) // rows * rows]
    recording = recorded(frame)
    assert any(f"held: new values at {100 // rows} Hz" in line for line in motion_limits(recording))
    assert consistent(fit(spatial(STATED), recording))


def test_a_rate_that_loses_the_motion_is_said() -> None:
    assert not motion_limits(recorded(run(300, 20)))
    lost = motion_limits(recorded(run(3000, 120).iloc[::10].reset_index(drop=True)))  # up to 4 Hz, at 10 Hz
    assert any("10 Hz cannot carry the motion in qx, qy, qz, qw: what is above" in s for s in lost), lost


@pytest.mark.parametrize("motion", ["sines", "raster", "point to point"])
def test_an_unrecorded_acceleration_is_recognised_whatever_it_biases(motion: str) -> None:
    """A raster's accelerations go with its orientation: the mass fitted without them is a quarter too small."""
    frame = SingleRun(noise="1/f", motion=motion, seed=7002).frame()
    fitted = fit(spatial(), recorded(frame.drop(columns=POSITION), rig=None))
    assert inertial_share(comparison_of(fitted, 0), fitted.model) > 0.9
    assert orientation_share(comparison_of(fitted, 0)) < 0.2
    reason = unknown_tool_reason([comparison_of(fitted, 0)], fitted.model)
    assert tool_text(fitted, misfitting=True, unknown=reason).startswith(
        "The tool is not known, as what the model lacks looks like an acceleration that was not recorded (log the"
        " position)"
    )


def test_an_acceleration_that_changes_from_sample_to_sample_is_recognised() -> None:
    """Above a quarter of the rate its differences are larger than itself, which is not then called noise."""
    frame = SingleRun(noise="white", motion="sines", seed=7003).frame()
    pose, time = frame[ORIENTATION], frame["time"].to_numpy()
    turn = Rotation.from_quat(pose.to_numpy())
    shaken = turn.inv().apply(np.outer(np.sin(2 * np.pi * 0.3 / (time[1] - time[0]) * time), [3.0, 2.0, 1.0]))
    moment = np.cross([0.01, -0.02, 0.06], shaken)
    frame[list(SPATIAL_CHANNELS)] += np.hstack([shaken, moment])
    fitted = fit(spatial(), recorded(frame.drop(columns=POSITION), rig=None))
    assert unknown_tool_reason([comparison_of(fitted, 0)], fitted.model)


def test_no_parameter_of_an_unknown_tool_is_printed_as_known() -> None:
    frame = SingleRun(noise="white", motion="point to point", seed=7004).frame()
    for position, known in ((POSITION, True), ([], False)):
        columns = [c for c in frame if c in {"time", *ORIENTATION, *SPATIAL_CHANNELS, *position}]
        fitted = fit(spatial(), recorded(frame[columns], rig=None))
        found = FitSummary(fitted, fitted.intervals())
        table, _ = found.parameters().split("(m mass")
        assert (table.count("±"), table.count("not known")) == ((16, 0) if known else (0, 16))


@pytest.mark.long(seconds=4)
def test_reports_and_files_say_that_the_tool_is_unknown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = SingleRun(noise="white", motion="point to point", seed=7004).frame()
    path = tmp_path / "run.csv"
    frame[["time", *ORIENTATION, *SPATIAL_CHANNELS]].to_csv(path, index=False)
    assert main(["fit", str(path), "--report", str(tmp_path / "fit"), "--json"]) == 0
    only = ["--only", "viscous_drag", "--workers", "1"]
    assert main(["diagnose", str(path), "--report", str(tmp_path / "diagnosis"), "--json", *only]) == 0
    pages = [page for folder in ("fit", "diagnosis") for page in (tmp_path / folder).glob("*.[hm]*")]
    assert len(pages) == 4
    said = "The tool is not known, as what the model lacks looks like"
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert said in text
        assert text.count("not known") > 16  # no parameter has an interval
    model = tmp_path / "model.json"
    assert main(["fit", str(path), "--physical", "--out", str(model)]) == 0
    capsys.readouterr()
    for to in ("ur", "urdf"):
        assert main(["emit", str(model), "--to", to]) == 0
        emitted = capsys.readouterr()
        assert "NOT KNOWN: the readings do not say what it weighs" in emitted.out
        assert "warning: the tool is not known" in emitted.err


OTHERS = [effect() for effect in (CableSpring, ViscousDrag, GravityTilt, SensorRotation, TimeDelay, SensorLag, Magnet)]


@pytest.mark.parametrize("hidden", [None, SensorGain(), *OTHERS], ids=lambda effect: type(effect).__name__)
@pytest.mark.parametrize("seed", [7003, pytest.param(7005, marks=pytest.mark.long(seconds=0.5))])
def test_other_loads_are_not_taken_for_an_unrecorded_acceleration(hidden: HiddenEffect | None, seed: int) -> None:
    """The sensor's origin stays where it is, so that nothing is lost without its position."""
    path = point_to_point(seed)
    turn = QuinticPath(path.period, path.poses * [0, 0, 0, 1, 1, 1], path.start, path.move)
    effects = () if hidden is None else (hidden,)
    frame = simulate(SIMULATED, turn, hidden=effects, repeats=1, samples_per_period=1500, seed=3)
    fitted = fit(spatial(), recorded(frame.drop(columns=[*POSITION, "repeat"]), rig=None))
    assert not unknown_tool_reason([comparison_of(fitted, 0)], fitted.model)


def test_world_axes_are_those_of_the_world_on_any_base() -> None:
    """A sensor at rest in a base on its side: the world's upward axis is the base's x, turned into the sensor."""
    turns = Rotation.from_rotvec(np.random.default_rng(2).standard_normal((30, 3)))
    columns = dict(zip(ORIENTATION, turns.as_quat().T, strict=True)) | {"time": 0.01 * np.arange(30)}
    readings = dict(zip(SPATIAL_CHANNELS, np.random.default_rng(3).standard_normal((6, 30)), strict=True))
    side = Rig.from_data({"robot": {"gravity_direction": [-1.0, 0.0, 0.0]}})
    recording = from_columns(columns | readings, name="side.csv", rig=side)
    np.testing.assert_allclose(world_axes(recording)[:, :, 2], turns.inv().apply([1.0, 0.0, 0.0]), atol=1e-12)


def test_an_acceleration_that_was_not_recorded_is_recognised() -> None:
    whole = fit(spatial(), recorded(run(3000, 20), rig=None))
    without = fit(spatial(), recorded(run(3000, 20).drop(columns=POSITION), rig=None))
    assert not motion_notes([comparison_of(whole, 0)], whole.model)
    notes = motion_notes([comparison_of(without, 0)], without.model)
    assert any("looks like mass times an acceleration that was not recorded" in note for note in notes)
    evidence = RecordEvidence(lack_of_fit=0.5, unrecorded_acceleration=True)
    assert judge(RECORD_RULES, evidence)[0] is RecordVerdict.UNEXPLAINED


# ----------------------------------------------------------------------------------------------------motions at random


def test_motions_at_random_hold_the_columns_that_the_recording_holds() -> None:
    """A rate held for six samples in a short log: too few holds to be told, but not in sixteen copies of it."""
    time, rng = 0.01 * np.arange(114), np.random.default_rng(0)
    rate = np.cos(9 * time) + 0.01 * rng.standard_normal(114)
    columns = {"time": time, "phi": np.sin(9 * time) / 9, "dphi": np.repeat(rate[::6], 6)}
    readings = dict(zip(("fx", "fy", "tau"), rng.standard_normal((3, 114)), strict=True))
    recording = from_columns(columns | dict.fromkeys(("px", "py"), 0 * time) | readings, name="short.csv")
    assert "dphi" in recording.signals
    drawn = recording.drawn_motions(rng, 16)
    assert recording.motion.recorded.true_samples(["dphi"]) is None
    assert drawn.motion.recorded.true_samples(["dphi"]) is None
    np.testing.assert_array_equal(drawn.signals["dphi"], np.tile(recording.signals["dphi"], 16))
