"""Clocks and samples: what drivers do to them is noticed, mended where that is harmless, and said; --strict refuses."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from diagnosis.diagnosis import diagnose
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from estimation.case import Case
from estimation.reading.clock_offset import MotionRegressors
from estimation.reading.column_map import ColumnMap
from estimation.reading.log_reading import imported, read
from estimation.recordings.reading_report import StepKind
from modeling.chain.model import planar, spatial
from modeling.effects import named
from modeling.errors import InputError
from modeling.rig import Rig
from tests.shared.log_files import CHANNELS, POSITION, QUATERNION, Frame, original, poses_at, two_clocks
from tests.shared.recordings import FEW
from tests.shared.rigs import ARM_RIG
from truewrench.simulated_rig import (
    CableSpring,
    ContactEvent,
    GravityTilt,
    HiddenEffect,
    PlanarRig,
    SimulatedRig,
    SpatialRig,
    TimeDelay,
    ViscousDrag,
    simulate,
)

pytest.importorskip("mujoco")

OFFSET = 0.037
ROWS = 1000
"""Of the run, where samples are mended: 4 s."""
Spoil = Callable[[Frame], Frame]


def part() -> Frame:
    """The first 4 s of the run."""
    return original().iloc[:ROWS]


def written(frame: Frame, folder: Path, name: str = "log.csv") -> Path:
    """A CSV with a name that FORMATS does not have, so that it is imported."""
    path = folder / name
    frame.rename(columns={"time": "stamp"}).to_csv(path, index=False)
    return path


# -------------------------------------------------------------------------------------------- two clocks


def test_two_files_on_two_clocks(tmp_path: Path) -> None:
    """37 ms between them, 3 of 5000 samples lost; poses at 200 Hz, wrench at 500 Hz with jitter."""
    frame = original(5000)
    found = imported(*two_clocks(frame, tmp_path, OFFSET))
    offset = found.report.offset
    assert offset is not None
    assert offset.applied
    assert abs(offset.offset - OFFSET) < 2e-3
    assert offset.interval[0] < OFFSET < offset.interval[1]
    assert offset.std < 1e-3
    assert any(
        step.count == 3 and "missing samples interpolated" in step.what for step in found.report.of(StepKind.MENDED)
    )
    # Where the wrench was at 37 ms later stamps, there the motion is; 0.3 ms of error at up to 0.9 m/s and 2.5 rad/s.
    first = int(np.argmin(np.abs(frame["fx"].to_numpy() - found.columns["fx"][0])))
    truth = poses_at(frame, frame["time"].to_numpy()[first : first + found.report.samples])
    for names, speed in ((POSITION, 0.9), (QUATERNION, 2.5)):
        error = max(float(np.abs(found.columns[name] - truth[name]).max()) for name in names)
        assert error < 3e-4 * speed + 2e-6
    np.testing.assert_array_equal(found.recording().wrench[:, 0], found.columns["fx"])


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("offset", [-0.2, 0.0, 0.5])
def test_the_interval_holds_the_offset(offset: float, seed: int, tmp_path: Path) -> None:
    found = imported(*two_clocks(original(), tmp_path, offset, seed)).report.offset
    assert found is not None
    assert abs(found.offset - offset) < 4 * found.std  # exceeded once in 16 000 times
    assert found.applied is (offset != 0.0) or abs(found.offset) > 2 * found.std


@pytest.mark.parametrize(("hidden", "seed"), [(ContactEvent(), 1), (GravityTilt(), 2), (CableSpring(), 1)])
def test_the_interval_holds_whatever_is_hidden(hidden: HiddenEffect, seed: int, tmp_path: Path) -> None:
    """A tether moves with the arm as its inertia does: within its interval, but not within 2 ms."""
    rig = SpatialRig()
    motion = rig.random_motion(seed=seed, period=10.0)
    frame = simulate(rig, motion, hidden=[hidden], repeats=1, samples_per_period=2500, seed=seed + 100)
    sources = two_clocks(frame.drop(columns="repeat"), tmp_path, OFFSET, seed, seed)
    offset = imported(*sources).report.offset
    assert offset is not None
    assert abs(offset.offset - OFFSET) < 4 * offset.std  # exceeded once in 16 000 times
    if not isinstance(hidden, CableSpring):
        assert offset.std < 1e-3
        assert abs(offset.offset - OFFSET) < 2e-3


@pytest.mark.parametrize("seed", [1, 2])
def test_joint_angles_need_the_arm(seed: int, tmp_path: Path) -> None:
    """Planar joints and wrench in a file each."""
    arm = PlanarRig()
    motion = arm.random_motion(seed=seed, period=10.0)
    frame = simulate(arm, motion, hidden=[ViscousDrag()], repeats=1, samples_per_period=2500, seed=seed)
    wrench, joints = tmp_path / "w.csv", tmp_path / "j.csv"
    frame[["time", "fx", "fy", "tau"]].assign(time=frame["time"] + OFFSET).to_csv(wrench, index=False)
    frame[["time", "q1", "q2", "q3"]].to_csv(joints, index=False)
    rig = Rig.from_data({"robot": {"link_lengths": list(arm.link_lengths)}})
    found = imported(wrench, joints, rig=rig).report.offset
    assert found is not None
    assert found.applied
    assert abs(found.offset - OFFSET) < min(2e-3, 4 * found.std)


def test_joint_angles_without_the_arm_give_no_offset(tmp_path: Path) -> None:
    arm = PlanarRig()
    frame = simulate(arm, arm.random_motion(seed=1, period=10.0), repeats=1, samples_per_period=500, seed=1)
    wrench, joints = tmp_path / "w.csv", tmp_path / "j.csv"
    frame[["time", "fx", "fy", "tau"]].assign(time=frame["time"] + OFFSET).to_csv(wrench, index=False)
    frame[["time", "q1", "q2", "q3"]].to_csv(joints, index=False)
    blind = imported(wrench, joints).report
    assert blind.offset is None
    assert any("is not estimated: columns q1, q2, q3" in step.what for step in blind.of(StepKind.SUSPICIOUS))


def test_the_forces_regressors_are_those_of_all() -> None:
    rng = np.random.default_rng(0)
    motion = MotionRegressors(
        np.arange(50.0), rng.normal(size=(50, 3)), rng.normal(size=(50, 4, 3)), rng.normal(size=(50, 9))
    )
    instants = rng.uniform(0.0, 49.0, 200)
    np.testing.assert_allclose(motion.of_forces(instants), motion.at(instants)[0], rtol=0, atol=1e-12)


def test_a_stated_offset_is_applied(tmp_path: Path) -> None:
    found = imported(*two_clocks(original(), tmp_path, OFFSET), map=ColumnMap.of({"offset": 0.037})).report.offset
    assert found is not None
    assert (found.offset, found.applied) == (0.037, True)


def test_the_same_stamps_are_one_clock(tmp_path: Path) -> None:
    """A delay in the sensor is no offset of clocks: said, and applied only where it is stated."""
    rig = SpatialRig()
    motion = rig.random_motion(seed=1, period=10.0)
    frame = simulate(rig, motion, hidden=[TimeDelay(delay=0.02)], repeats=1, samples_per_period=2500, seed=1)
    wrench, pose = tmp_path / "wrench.csv", tmp_path / "pose.csv"
    frame[["time", *CHANNELS]].to_csv(wrench, index=False)
    frame[["time", *POSITION, *QUATERNION]].to_csv(pose, index=False)
    report = imported(wrench, pose).report
    assert report.offset is not None
    assert abs(report.offset.offset - 0.02) < 2e-3
    assert not report.offset.applied
    assert report.samples == len(frame)
    assert any("--clock-offset" in step.what for step in report.of(StepKind.SUSPICIOUS))
    stated = imported(wrench, pose, clock_offset=0.02).report
    assert stated.offset is not None
    assert (stated.offset.offset, stated.offset.applied) == (0.02, True)
    assert "Clock offset: 20 ms as stated" in str(stated)


def test_clocks_of_different_origins(tmp_path: Path) -> None:
    """The controller counts from its start, the sensor's computer from 1970: first samples are aligned at first."""
    found = imported(*two_clocks(original(), tmp_path, 1_760_000_000.25))
    assert found.report.offset is not None
    assert abs(found.report.offset.offset % 1 - 0.25) < 2e-3
    assert any("first samples are aligned" in step.what for step in found.report.of(StepKind.SUSPICIOUS))


def test_a_tool_that_never_turns_gives_no_offset(tmp_path: Path) -> None:
    frame = original().assign(fx=0.1, qx=0.0, qy=0.0, qz=0.0, qw=1.0, px=0.0, py=0.0, pz=0.0)
    frame[CHANNELS] = np.random.default_rng(0).normal(0, 0.1, (len(frame), 6))
    wrench, pose = written(frame[["time", *CHANNELS]], tmp_path, "w.csv"), tmp_path / "p.csv"
    frame[["time", *QUATERNION, *POSITION]].assign(time=frame["time"] + 0.01).to_csv(pose, index=False)
    report = imported(wrench, pose).report
    assert report.offset is None or not report.offset.applied
    assert any("cannot be estimated" in step.what for step in report.of(StepKind.SUSPICIOUS))


def test_logs_that_do_not_overlap_and_have_one_origin(tmp_path: Path) -> None:
    frame = original()
    wrench = written(frame[["time", *CHANNELS]].iloc[:400], tmp_path, "w.csv")
    pose = tmp_path / "p.csv"
    frame[["time", *QUATERNION, *POSITION]].iloc[2000:].to_csv(pose, index=False)
    with pytest.raises(InputError, match="do not overlap"):
        imported(wrench, pose)


# --------------------------------------------------------------------------------------------- samples


def lose(*rows: int) -> Spoil:
    return lambda f: f.drop(index=list(rows))


def swap(row: int) -> Spoil:
    def spoil(frame: Frame) -> Frame:
        order = np.arange(len(frame))
        order[[row, row + 1]] = order[[row + 1, row]]
        return frame.iloc[order]

    return spoil


def damage(stamp: float, *rows: int) -> Spoil:
    """Rows with a stamp that no clock gave."""
    return lambda f: f.assign(time=f["time"].where(~f.index.isin(rows), stamp))


def blank(row: int, *columns: str) -> Spoil:
    def spoil(frame: Frame) -> Frame:
        frame = frame.copy()
        frame.loc[row, list(columns)] = np.nan
        return frame

    return spoil


def double(*rows: int) -> Spoil:
    return lambda f: f.iloc[np.sort(np.concatenate([np.arange(len(f)), rows]))]


HARMLESS: dict[str, tuple[Spoil, str]] = {
    "lost": (lose(500, 501, 720), "missing samples interpolated (3 of 1000)"),
    "swapped": (swap(700), "put in the order of time (1 of 1000)"),
    "doubled": (double(3, 900), "doubled rows left out (2 of 1002)"),
    "empty cells": (blank(300, "fz"), "empty or held cells left out (1 of 1000)"),
    "empty row": (blank(300, "time"), "without time left out (1 of 1000)"),
    "damaged stamp": (damage(1e12, 300), "without time left out (1 of 1000)"),
    "damaged stamps": (damage(-1e300, 1, 500, 998), "without time left out (3 of 1000)"),
}


@pytest.mark.parametrize("case", HARMLESS)
def test_what_is_harmless_is_mended(case: str, tmp_path: Path) -> None:
    spoil, said = HARMLESS[case]
    path = written(spoil(part()), tmp_path)
    found = imported(path)
    assert any(said in str(step) for step in found.report.of(StepKind.MENDED)), str(found.report)
    assert found.report.samples == ROWS
    for name in (*CHANNELS, *QUATERNION, *POSITION):
        error = np.abs(found.columns[name] - part()[name].to_numpy())
        # An interpolated sample of the wrench lacks its noise, and has its neighbours': 6 std of both; of the motion it
        # has their quantisation, 1 µm and 6e-6 rad, times at most 1.5.
        assert error.max() < (0.8 if name in CHANNELS else 1e-5)
        assert np.count_nonzero(error > 1e-9) <= 3
    with pytest.raises(InputError, match=r"would have to be mended.*leave out --strict"):
        imported(path, strict=True)


@pytest.mark.parametrize("stamp", [1e300, 1e30, 1e18, 5e4, 1e-300, -1e12, -1e300])
@pytest.mark.parametrize("row", [0, 300, ROWS - 1])
def test_a_damaged_stamp_costs_its_row_alone(row: int, stamp: float, tmp_path: Path) -> None:
    """At the ends nothing can be interpolated."""
    found = imported(written(damage(stamp, row)(part()), tmp_path))
    assert found.report.samples == (ROWS if row == 300 or (row, stamp) == (0, 1e-300) else ROWS - 1)
    assert found.report.rate == pytest.approx(250, rel=1e-6)


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_many_damaged_stamps_are_one_line_or_a_reading(seed: int, scattered: bool, tmp_path: Path) -> None:
    """A tenth of all stamps, over 600 or 60 decades: no clock is filled up between them, and nothing overflows."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(400, 40, replace=False) if scattered else np.arange(100, 140)
    stamps = part()["time"].to_numpy()[:400].copy()
    stamps[rows] = 10.0 ** rng.uniform(-1, 1, 40 if scattered else 1) ** 3 * 10.0 ** rng.uniform(-30, 30, 40)
    with suppress(InputError):
        assert imported(written(part().iloc[:400].assign(time=stamps), tmp_path)).report.samples < 100 * 400


def test_untouched_is_not_mended(tmp_path: Path) -> None:
    found = imported(written(part(), tmp_path), strict=True)
    assert not found.report.of(StepKind.MENDED)
    assert not found.report.of(StepKind.SUSPICIOUS)


def test_a_long_gap_cuts(tmp_path: Path) -> None:
    found = imported(written(part().drop(index=range(300, 400)), tmp_path))
    assert found.report.samples == 600
    np.testing.assert_allclose(found.columns["fx"], part()["fx"][400:], atol=1e-12)
    mended = map(str, found.report.of(StepKind.MENDED))
    assert any("1 gap of up to 0.404 s: the longest piece is kept" in step for step in mended)


def test_time_that_restarts(tmp_path: Path) -> None:
    two = part().iloc[[*range(600), *range(400)]]
    found = imported(written(two, tmp_path))
    assert found.report.samples == 600
    assert any("longest of 2 runs" in step.what for step in found.report.of(StepKind.MENDED))


def test_runs_that_a_repeat_column_counts(tmp_path: Path) -> None:
    """Time restarts in each: all are kept, and a lost sample of one is mended."""
    runs = original().iloc[:400]
    frame = pd.concat([runs, runs.drop(index=[200]), runs], ignore_index=True)
    frame = frame.assign(repeat=np.repeat([0, 1, 2], [400, 399, 400]), fx=frame["fx"]).rename(columns={"fx": "Fx"})
    found = imported(written(frame, tmp_path))
    assert found.report.samples == 1200
    assert any(step.count == 1 and "missing samples interpolated" in step.what for step in found.report.steps)
    recording = found.recording()
    assert (recording.repeats, recording.continuous) == (3, False)


def test_incomplete_repeats_at_the_ends_are_left_out(tmp_path: Path) -> None:
    """On two clocks the ends do not overlap, and repeats have to be equally long."""
    count = 5
    frame = original().iloc[: count * 200].assign(repeat=np.repeat(np.arange(count), 200))
    wrench = written(frame[["time", "repeat", *CHANNELS]], tmp_path, "w.csv")
    pose = tmp_path / "p.csv"
    frame[["time", *QUATERNION, *POSITION]].iloc[30:-40].to_csv(pose, index=False)
    found = imported(wrench, pose)
    assert any("incomplete repeats" in step.what for step in found.report.of(StepKind.MENDED))
    assert found.recording().repeats == count - 2


def test_an_estimated_offset_goes_with_the_recording(tmp_path: Path) -> None:
    """A sensor that is 14 ms late on one clock: what takes that in is said, and no delay is called negligible."""
    rig, path = SpatialRig(), tmp_path / "recording.csv"
    hidden = [TimeDelay(delay=0.014)]
    frame = simulate(rig, rig.random_motion(seed=3, period=10.0), hidden=hidden, repeats=1, samples_per_period=2500)
    sources = two_clocks(frame.drop(columns="repeat"), tmp_path, 0.0)
    log = imported(*sources)
    pd.DataFrame(dict(log.columns)).to_csv(path, index=False)
    for recording in (read(path), log.recording(), imported(path).recording()):
        assert "clock_offset" not in recording.auxiliary
        (doubted,) = Case.of(spatial(), [recording]).readings
        assert doubted.id == "clock_offset"
        assert doubted.value == pytest.approx(0.014, abs=1e-3)
        assert "--clock-offset" in doubted.statement
    effects = [named(i) for i in ("time_delay", "sensor_lag", "viscous_drag")]
    findings = {f.effect.id: f for f in diagnose(spatial(), read(path), effects=effects).findings}
    assert findings["viscous_drag"].verdict is EffectVerdict.NEGLIGIBLE
    for late in ("time_delay", "sensor_lag"):
        assert findings[late].verdict is EffectVerdict.NOT_EXCITED
        assert "import with --clock-offset" in findings[late].reason
    stated = imported(*sources, clock_offset=0.0)
    assert "clock_offset" not in stated.columns
    assert not Case.of(spatial(), [stated.recording()]).readings


@pytest.mark.parametrize("drag", [(), (ViscousDrag(c=0.4),)], ids=["alone", "beside a drag"])
@pytest.mark.parametrize(
    ("rig", "samples"),
    [
        (PlanarRig(), 1000),
        *(pytest.param(r, n, marks=pytest.mark.long) for r, n in ((PlanarRig(), 4000), (SpatialRig(), 1500))),
    ],
)
def test_an_offset_and_a_drag_beside_it_are_both_named(
    rig: SimulatedRig, samples: int, drag: tuple[ViscousDrag, ...], tmp_path: Path
) -> None:
    """Poses at rest have no clocks. An offset that errs by two std may be taken for a drag: of 12 such logs one was."""
    frame = simulate(rig, rig.random_motion(seed=2), hidden=drag, repeats=1, samples_per_period=samples, seed=4)
    motion = [*QUATERNION, *POSITION] if "qw" in frame else ["q1", "q2", "q3"]
    wrench, pose, described = tmp_path / "w.csv", tmp_path / "m.csv", None if "qw" in frame else ARM_RIG
    frame[["time", *rig.channels]].assign(time=frame["time"] + OFFSET).to_csv(wrench, index=False)
    frame[["time", *motion]].to_csv(pose, index=False)
    recording = imported(wrench, pose, rig=described).recording(described)
    diagnosis = diagnose(spatial() if described is None else planar(described), recording, effects=FEW)
    assert [(r.id, r.value) for r in diagnosis.readings] == [("clock_offset", pytest.approx(OFFSET, abs=2e-3))]
    assert diagnosis.added == (("viscous_drag",) if drag else ())
    assert diagnosis.verdict is (RecordVerdict.EXPLAINED if drag else RecordVerdict.NOTHING_MISSING)
    assert diagnosis.fit.values["m"] == pytest.approx(rig.mass, rel=0.003)


@pytest.mark.parametrize("received", ["%time", "time", "Time"])
def test_the_stamp_of_the_sensor_comes_before_that_of_receipt(received: str, tmp_path: Path) -> None:
    """Receipt is 30 ms late, with jitter, and that is said."""
    frame, rng = part(), np.random.default_rng(0)
    late = 1.7e9 + frame["time"] + 0.03 + rng.exponential(0.001, len(frame))
    log = frame.rename(columns={"time": "header.stamp"}).assign(**{received: late})
    log["header.stamp"] += 1.7e9
    log.to_csv(tmp_path / "log.csv", index=False)
    found = imported(tmp_path / "log.csv")
    np.testing.assert_allclose(np.diff(found.columns["time"]), np.diff(frame["time"]), atol=1e-6)
    said = [step.what for step in found.report.steps if "time from header.stamp" in step.what]
    assert len(said) == 1
    assert f"{received} is not used, 30" in said[0]


def test_a_stamp_that_stands_still_is_not_the_time(tmp_path: Path) -> None:
    part().assign(**{"header.stamp": 0.0}).to_csv(tmp_path / "log.csv", index=False)
    steps = imported(tmp_path / "log.csv").report.steps
    (said,) = [step.what for step in steps if "time from time" in step.what]
    assert said.endswith("header.stamp is not used, as it does not increase")


def test_a_record_too_short_for_an_offset(tmp_path: Path) -> None:
    sources = two_clocks(original().iloc[:400], tmp_path, 0.0)
    report = imported(*sources).report
    assert report.offset is None
    assert any("too short to estimate" in step.what for step in report.of(StepKind.SUSPICIOUS))


@pytest.mark.parametrize("held", [4, 5])
def test_a_held_wrench_is_used_where_it_is_new(held: int, tmp_path: Path) -> None:
    frame = part().copy()
    frame[CHANNELS] = frame[CHANNELS].iloc[np.arange(len(frame)) // held * held].to_numpy()
    found = imported(written(frame, tmp_path))
    assert found.report.rate == pytest.approx(250 / held, rel=1e-3)
    np.testing.assert_allclose(found.columns["fy"], part()["fy"][::held], atol=1e-9)
    np.testing.assert_allclose(found.columns["px"], part()["px"][::held], atol=3e-6)
    assert any(f"held for {held} rows" in step.what for step in found.report.of(StepKind.MENDED))


def test_a_held_pose_is_rebuilt(tmp_path: Path) -> None:
    frame = part().copy()
    columns = [*QUATERNION, *POSITION]
    frame[columns] = frame[columns].iloc[np.arange(len(frame)) // 5 * 5].to_numpy()
    found = imported(written(frame, tmp_path))
    assert found.report.rate == pytest.approx(250.0)
    expected = part()["px"].to_numpy()[: found.report.samples]
    np.testing.assert_allclose(found.recording().signals["px"], expected, atol=5e-6)


def test_jitter_is_believed_less_than_the_clock(tmp_path: Path) -> None:
    """0.4 of a sample of jitter: the samples stay as they are, on a uniform clock."""
    frame = part().copy()
    frame["time"] += np.random.default_rng(0).uniform(-0.4, 0.4, len(frame)) * 0.004
    found = imported(written(frame, tmp_path))
    np.testing.assert_array_equal(found.columns["fx"], part()["fx"])
    assert found.report.rate == pytest.approx(250.0, rel=1e-4)
    assert found.report.clocks[0].jitter == pytest.approx(0.004 * 0.8 / np.sqrt(12), rel=0.05)


def test_irregular_sampling_is_interpolated(tmp_path: Path) -> None:
    """Sampled at other instants indeed: a random walk of the step. The pose is that of the uniform instants."""
    steps = 0.004 * (1 + 0.3 * np.sin(np.arange(ROWS) / 120))
    stamps = np.cumsum(steps) - steps[0]
    frame = part().copy()
    frame[[*QUATERNION, *POSITION]] = poses_at(frame, stamps)[[*QUATERNION, *POSITION]].to_numpy()
    frame["time"] = stamps
    found = imported(written(frame, tmp_path))
    assert any("sampled irregularly" in step.what for step in found.report.of(StepKind.MENDED))
    expected = poses_at(frame, found.columns["time"])
    np.testing.assert_allclose(found.columns["px"], expected["px"], atol=5e-6)


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("epoch", [0, 1_760_000_000])
def test_units_of_time_are_recognised(scale: float, unit: str, epoch: int, tmp_path: Path) -> None:
    frame = original().copy()
    frame["time"] = np.round((frame["time"] + epoch) * scale) if epoch else frame["time"] * scale
    found = imported(written(frame, tmp_path))
    assert found.report.rate == pytest.approx(250.0, rel=1e-6)
    assert any(f": {unit}" in step.what and "recognised" in step.what for step in found.report.steps)


def test_time_in_doubt_is_asked_for(tmp_path: Path) -> None:
    frame = part().assign(time=np.arange(float(ROWS)))
    path = written(frame, tmp_path)
    with pytest.raises(InputError, match="seconds, milliseconds or a count of samples"):
        imported(path)
    stated = tmp_path / "map.toml"
    stated.write_text('units = { time = "ms" }')
    assert imported(path, map=stated).report.rate == pytest.approx(1000.0)


def test_channels_that_stand_still_or_clip_are_suspicious(tmp_path: Path) -> None:
    frame = part().assign(tz=0.25)
    frame["fz"] = np.minimum(frame["fz"], np.quantile(frame["fz"], 0.9))
    frame["fx"] = np.where(np.abs(frame["fx"]) < 1.0, 0.0, frame["fx"])
    report = imported(written(frame, tmp_path)).report
    said = "\n".join(map(str, report.of(StepKind.SUSPICIOUS)))
    assert "tz never changes" in said
    assert "fz stays at its extreme value" in said
    assert "fx is exactly zero" in said


# --------------------------------------------------------------------------------------------- periods


def test_a_stated_period_cuts_repeats(tmp_path: Path) -> None:
    whole = original().iloc[::5]
    path = written(whole.iloc[np.arange(1200) % 500].assign(time=np.arange(1200) * 0.02), tmp_path)
    found = imported(path, period=10.0)
    np.testing.assert_array_equal(np.unique(found.columns["repeat"], return_counts=True)[1], [500, 500])
    recording = found.recording()
    assert recording.repeats == 2
    assert recording.continuous
    off = imported(path, period=9.999)
    assert any("samples a period" in step.what for step in off.report.of(StepKind.MENDED))
    with pytest.raises(InputError, match="fits"):
        imported(path, period=20.0)
