"""Rows and channels that are no readings are named with their numbers, alone and beside physics; none is invented."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.diagnosis import diagnose_case
from diagnosis.verdict_rule import RecordVerdict
from estimation.case import Case
from estimation.fit import fit_case
from estimation.reading.log_reading import imported, read
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.row_reading import pose_outlier
from estimation.recordings.reading_report import StepKind
from estimation.recordings.recording import Recording
from modeling.chain.model import planar, spatial
from modeling.effects import named
from modeling.errors import InputError
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.recordings import FEW, recording_of
from truewrench.command_line import main
from truewrench.simulated_rig import (
    CableSpring,
    HiddenEffect,
    PlanarRig,
    Saturation,
    SensorGain,
    SimulatedRig,
    SpatialRig,
    ViscousDrag,
    simulate,
    static_poses,
    write_recording,
)

Array = NDArray[np.float64]

SPACE, PLANE = SpatialRig(), PlanarRig()
PLANAR = Rig(link_lengths=PLANE.link_lengths, tip_length=0.2)
KINDS = ("static", "static in the plane", "run", "run in the plane")
DRAG = ViscousDrag(c=0.4, d=0.12)
AT_REST = tuple(named(i) for i in ("cable_spring", "saturation", "sensor_gain", "gravity_tilt"))
"""Candidates of which each may act in poses at rest."""
QUATERNION = ["qx", "qy", "qz", "qw"]
POSE = {"q": "orientation", "p": "position"}


def frame_of(kind: str, seed: int = 1, *hidden: HiddenEffect) -> pd.DataFrame:
    """Readings of the rig; a temperature that changes with time is none of a pose's. A long run is at 1200 Hz."""
    rig: SimulatedRig = PLANE if "plane" in kind else SPACE
    if kind.startswith("static"):
        frame = static_poses(rig, 24, hidden=hidden, seed=seed)
    else:
        samples, repeats = 6000 if kind.startswith("long") else 900, 3 if kind.startswith("repeats") else 1
        motion = rig.random_motion(seed=seed)
        frame = simulate(rig, motion, hidden=hidden, repeats=repeats, samples_per_period=samples // repeats, seed=seed)
        frame = frame if repeats > 1 else frame.drop(columns="repeat")
    return frame.drop(columns="temperature", errors="ignore")


def pushed(frame: pd.DataFrame, rows: int | list[int], channel: str, by: float | Array) -> pd.DataFrame:
    """The frame with a channel changed in some rows."""
    readings = frame[channel].to_numpy(dtype=float, copy=True)
    readings[rows] += by
    return frame.assign(**{channel: readings})


def turned(frame: pd.DataFrame, row: int, by: Rotation) -> pd.DataFrame:
    """The frame with another orientation in one row."""
    quaternions = frame[QUATERNION].to_numpy(dtype=float, copy=True)
    quaternions[row] = (Rotation.from_quat(quaternions[row]) * by).as_quat()
    return frame.assign(**dict(zip(QUATERNION, quaternions.T, strict=True)))


def case_of(frame: pd.DataFrame, *read: str, as_read: bool = False) -> Case:
    plane = "tau" in frame
    recording = recording_of(frame, rig=PLANAR if plane else None)
    return Case.of(planar(PLANAR) if plane else spatial(), [recording], read=read, as_read=as_read)


def one(case: Case) -> DoubtedReading:
    (reading,) = case.readings
    return reading


def mass_is_right(case: Case) -> bool:
    """Within four std of the rig's, as one in fifteen thousand is not."""
    mass = fit_case(case).parameters["m"]
    return abs(mass.value - (PLANE if case.model.space.value == 2 else SPACE).mass) < 4 * mass.std


@pytest.mark.parametrize("kind", KINDS)
def test_one_row_that_was_pushed_is_named_and_left_out_when_asked(kind: str) -> None:
    frame = frame_of(kind)
    row = 5 if kind.startswith("static") else 500
    frame = pushed(frame, row, "fx", 6.0)
    case = case_of(frame)
    reading = one(case)
    assert (reading.id, reading.value, reading.adopted) == ("pose_outlier", [row + 1], False)
    assert f"{'pose' if case.recordings[0].at_rest else 'sample'} {row + 1} does not belong" in reading.sentence
    assert case.misread
    assert reading.before is not None
    assert reading.after is not None
    assert reading.before > 3 * reading.after
    read = case_of(frame, "pose_outlier")
    assert one(read).adopted
    assert not read.misread
    assert mass_is_right(read)
    assert case_of(frame, as_read=True).readings == ()


def test_two_rows_that_would_hide_each_other_are_named() -> None:
    frame = pushed(frame_of("static"), [3, 17], "fz", 8.0)
    assert one(case_of(frame)).value == [4, 18]
    case = case_of(frame, "pose_outlier")
    assert case.recordings[0].samples == 22
    assert mass_is_right(case)


@pytest.mark.parametrize("kind", ["static", "run"])
def test_a_wrong_orientation_of_a_right_wrench_is_named(kind: str) -> None:
    row = 9 if kind == "static" else 400
    frame = turned(frame_of(kind), row, Rotation.from_rotvec([0.7, 0.0, 0.0]))
    assert one(case_of(frame)).value == [row + 1]
    assert mass_is_right(case_of(frame, "pose_outlier"))


def test_a_quaternion_that_changes_sign_and_an_angle_that_wraps_are_no_jumps() -> None:
    frame = frame_of("run")
    for name in QUATERNION:
        frame = pushed(frame, 300, name, -2 * frame[name].to_numpy()[300])
    assert case_of(frame).readings == ()
    frame = pushed(frame_of("run in the plane"), 300, "q3", 2 * np.pi)
    assert pose_outlier([recording_of(frame, rig=PLANAR)]) is None


def test_a_step_and_a_knock_are_no_jumps() -> None:
    frame = frame_of("run")
    step = pushed(frame, list(range(450, 900)), "fz", 5.0)
    knock = pushed(frame, list(range(450, 471)), "fz", 8.0 * np.exp(-np.arange(21) / 6) * np.cos(np.arange(21)))
    assert pose_outlier([recording_of(step)]) is None
    assert pose_outlier([recording_of(knock)]) is None


def test_several_recordings_name_theirs() -> None:
    first, second = frame_of("static", 1), pushed(frame_of("static", 2), 7, "ty", 1.0)
    several = [recording_of(first, name="first"), recording_of(second, name="second")]
    reading = one(Case.of(spatial(), several))
    assert reading.value == {"second": [8]}
    assert "pose 8 of second does not belong" in reading.sentence


@cache
def poses(count: int) -> Recording:
    return recording_of(static_poses(SPACE, count, seed=count))


def noise_of(draw: Callable[[np.random.Generator, tuple[int, int]], Array], seed: int) -> Recording:
    """Poses with noise of another distribution, its size six times as large in some channels as in others."""
    rng = np.random.default_rng(seed)
    at_rest = poses(int(rng.integers(12, 41)))
    std = np.array(SPACE.noise) * 10 ** rng.uniform(-0.5, 0.3, len(SPACE.noise))
    return at_rest.with_readings(np.array([[9.0, -4, 2, 1, 0.5, 0.1]]) + draw(rng, at_rest.wrench.shape) * std)


def test_nothing_is_invented_of_noise() -> None:
    """At one percent each, more than 5 of 200 have a probability of 2 %; of heavy tails three percent is expected."""
    normal = [pose_outlier([noise_of(lambda rng, size: rng.standard_normal(size), seed)]) for seed in range(200)]
    assert sum(shown is not None for shown in normal) <= 2
    heavy = [pose_outlier([noise_of(lambda rng, size: rng.standard_t(4, size), seed)]) for seed in range(200)]
    assert sum(shown is not None for shown in heavy) <= 12


# ------------------------------------------------------------------------- every kind, alone and beside a drag


def other_orientation(frame: pd.DataFrame, row: int) -> pd.DataFrame:
    """The frame with another orientation in one row, of a joint in the plane."""
    return pushed(frame, row, "q3", 0.7) if "q3" in frame else turned(frame, row, Rotation.from_rotvec([0.7, 0.0, 0.0]))


def clipped(frame: pd.DataFrame) -> pd.DataFrame:
    """The frame with fx at the limits of a range about zero."""
    limit = 0.8 * float(np.abs(frame["fx"]).max())
    return frame.assign(fx=frame["fx"].clip(-limit, limit))


SPOILED: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "pose_outlier of a force": lambda f: pushed(f, len(f) // 2, "fx", 20.0),
    "pose_outlier of an orientation": lambda f: other_orientation(f, len(f) // 2),
    "channel_constant": lambda f: f.assign(fy=0.25),
    "channel_copied": lambda f: f.assign(tau=-f.fx) if "tau" in f else f.assign(tz=-f.ty),
    "channel_saturated": clipped,
}
"""What is named, with the change to a frame that it is said of."""
NAMED_ON = [
    (kind, drag, spoiled)
    for kind in (*KINDS, "long", "long in the plane", "repeats", "repeats in the plane")
    for drag in (False, True)
    for spoiled in SPOILED
    if not (drag and kind.startswith("static"))  # nothing drags a tool that rests
    if not (kind.startswith("repeats") and spoiled == "pose_outlier of a force")  # repeats show it by themselves
    if drag or not kind.startswith("repeats")  # alone it is as in a run
]


@pytest.mark.parametrize(
    ("kind", "drag", "spoiled"),
    [
        pytest.param(*case, marks=() if case[0].startswith("static") or case[:2] == ("run in the plane", True)
                     else pytest.mark.long)
        for case in NAMED_ON
    ],
)  # fmt: skip
def test_it_is_named_on_every_kind_and_a_drag_beside_it_too(kind: str, drag: bool, spoiled: str) -> None:
    """By its name first; once it is read so, or where `saturation` says the same, the drag and nothing else."""
    frame = SPOILED[spoiled](frame_of(kind, 2, *[DRAG] * drag))
    name, effect = spoiled.split()[0], "saturation" if spoiled == "channel_saturated" else ""
    case = case_of(frame)
    assert (one(case).id, case.misread) == (name, True)
    candidates = (*FEW[:2], named("saturation")) if effect else FEW
    diagnosis = diagnose_case(case_of(frame, name), effects=candidates)
    if kind.startswith("long") and (drag, effect) == (
        False,
        "saturation",
    ):  # what a level leaves counts as noise of so long a run
        assert (diagnosis.added, diagnosis.verdict) == ((), RecordVerdict.UNEXPLAINED)
        return
    assert [(reading.id, reading.adopted) for reading in diagnosis.readings] == [(name, True)]
    effects = {effect} - {""} if not kind.startswith("static") else set()
    assert set(diagnosis.added) == effects | ({"viscous_drag"} if drag else set())
    assert diagnosis.verdict is (RecordVerdict.EXPLAINED if diagnosis.added else RecordVerdict.NOTHING_MISSING)
    mass = diagnosis.fit.parameters["m"]
    truth = (PLANE if "plane" in kind else SPACE).mass
    assert mass.value == pytest.approx(truth, abs=max(4 * mass.std, 0.001 * truth))
    if drag:
        assert diagnosis.fit.values["viscous_drag.c"] == pytest.approx(DRAG.c, rel=0.05)


@pytest.mark.parametrize("kind", ["static", "run", pytest.param("long", marks=pytest.mark.long)])
def test_an_orientation_that_is_no_rotation_is_refused_or_left_out(kind: str, tmp_path: Path) -> None:
    """In the plane an angle is one, whatever it is. Of an imported log the rows that are none are, as damaged ones."""
    frame = frame_of(kind, 1, *[DRAG] * (kind != "static"))
    stretched, row = frame.assign(**{name: 1.3 * frame[name] for name in QUATERNION}), 12
    damaged = pushed(frame, row, "qx", 2.0)
    for wrong, where in ((stretched, 0), (damaged, row)):
        path = str(write_recording(wrong, tmp_path / "log.csv"))
        with pytest.raises(InputError, match=rf"at row {where + 2} have norm .* instead of 1; give unit quaternions"):
            read(path)
    names = {f"{letter}{axis}": f"pose.{part}.{axis}" for letter, part in POSE.items() for axis in "xyzw"}
    path = str(write_recording(stretched.rename(columns=names), tmp_path / "log.csv"))
    with pytest.raises(InputError, match=r"the quaternion's norm is 1.3 instead of 1"):
        imported(path)
    path = str(write_recording(damaged.rename(columns=names), tmp_path / "log.csv"))
    log = imported(path)
    assert mass_is_right(Case.of(spatial(), [log.recording()]))
    assert log.report.of(StepKind.MENDED)


# ----------------------------------------------------------------------------------------------- channels


@pytest.mark.parametrize("channel", ["tx", "fz", "tau", "fy"])
@pytest.mark.parametrize("kind", ["static", "run"])
def test_a_channel_that_never_changes_is_named_and_weighs_nothing(kind: str, channel: str) -> None:
    frame = frame_of(f"{kind} in the plane" if channel in ("tau", "fy") else kind)
    frame[channel] = 0.25
    case = case_of(frame)
    reading = one(case)
    assert (reading.id, reading.value, reading.adopted) == ("channel_constant", [channel], False)
    assert "--read channel_constant" in reading.statement
    assert case.misread
    for read_so in (case, case_of(frame, "channel_constant")):
        fit = fit_case(read_so)
        assert mass_is_right(read_so)
        assert np.isinf(fit.parameters[f"bias_{channel}"].std)
        assert all(np.isinf(p.std) or p.std > 1e-5 * max(1.0, abs(p.value)) for p in fit.parameters.values())


def test_poses_that_are_all_the_same_have_no_constant_channel() -> None:
    frame = frame_of("static")
    frame = frame.iloc[[0] * len(frame)]
    stated = Rig(sensor=SensorDescription(convention=Convention.ON_TOOL))
    assert Case.of(spatial(stated), [recording_of(frame)]).readings == ()


@pytest.mark.parametrize("kind", ["static", "run"])
@pytest.mark.parametrize(("copy", "of", "sign"), [("fy", "fx", 1.0), ("tz", "ty", -1.0)])
def test_a_copied_channel_is_named_and_both_are_left_out_when_asked(kind: str, copy: str, of: str, sign: float) -> None:
    frame = frame_of(kind)
    frame[copy] = sign * frame[of]
    reading = one(case_of(frame))
    assert (reading.id, reading.value) == ("channel_copied", sorted((copy, of)))
    read = case_of(frame, "channel_copied")
    assert one(read).adopted
    assert mass_is_right(read)


def test_poses_at_a_channel_s_limit_are_named_and_left_out_when_asked() -> None:
    """Clipped at one end alone, as with a zero far off the middle of the range: no level of `saturation` does that."""
    frame = frame_of("static")
    limit = float(np.sort(frame["fz"])[-7])
    frame["fz"] = frame["fz"].clip(upper=limit)
    case = case_of(frame)
    reading = one(case)
    assert (reading.id, reading.value) == ("channel_saturated", {"fz": limit})
    assert diagnose_case(case).verdict is RecordVerdict.UNEXPLAINED
    read = case_of(frame, "channel_saturated")
    assert read.recordings[0].samples == 17
    assert mass_is_right(read)
    frame = pushed(frame, lowest := int(np.argmin(frame["fz"])), "fx", 6.0)
    both = case_of(frame, "channel_saturated", "pose_outlier")
    assert [r.id for r in both.readings] == ["channel_saturated", "pose_outlier"]
    assert both.readings[1].value == [lowest + 1]
    assert both.recordings[0].samples == 16


def test_saturation_of_a_run_is_the_effect_and_the_reading(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = clipped(frame_of("run in the plane"))
    case = case_of(frame)
    assert one(case).id == "channel_saturated"
    assert case.misread
    path, rig = str(write_recording(frame, tmp_path / "run.csv")), tmp_path / "rig.toml"
    rig.write_text(f"[robot]\nlink_lengths = {list(PLANE.link_lengths)}\n")
    assert main(["diagnose", path, "--rig", str(rig), "--only", "saturation", "viscous_drag", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["verdict"], said["added"]) == ("explained", ["saturation"])
    assert [(reading["id"], reading["adopted"]) for reading in said["readings"]] == [("channel_saturated", True)]


@pytest.mark.parametrize(("effect", "identity"), [(Saturation(), "saturation"), (CableSpring(), "cable_spring")])
def test_an_effect_that_acts_in_a_few_poses_explains_them(effect: Saturation | CableSpring, identity: str) -> None:
    """They do not belong to those of a rigid tool; with the effect they do, and both are said."""
    frame = static_poses(SPACE, 24, hidden=[effect], seed=3).drop(columns=["temperature"])
    case = case_of(frame)
    assert one(case).id == "pose_outlier"
    diagnosis = diagnose_case(case, effects=AT_REST)
    assert (diagnosis.added, diagnosis.verdict, diagnosis.readings) == ((identity,), RecordVerdict.EXPLAINED, ())
    (finding,) = (f for f in diagnosis.findings if f.effect.id == identity)
    assert "--read pose_outlier" in finding.reason


def test_a_pose_that_was_pushed_is_named_beside_a_gain() -> None:
    frame = static_poses(SPACE, 24, hidden=[SensorGain()], seed=3).drop(columns=["temperature"])
    frame = pushed(frame, 11, "fy", -9.0)
    assert one(case_of(frame)).value == [12]
    diagnosis = diagnose_case(case_of(frame), effects=AT_REST)
    assert diagnosis.verdict is RecordVerdict.UNEXPLAINED
    read = diagnose_case(case_of(frame, "pose_outlier"), effects=AT_REST)
    assert (read.added, read.verdict) == (("sensor_gain",), RecordVerdict.EXPLAINED)


def test_commands_say_it_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = pushed(frame_of("static"), 5, "fx", 6.0)
    path = str(write_recording(frame, tmp_path / "poses.csv"))
    for command in (["fit", path], ["diagnose", path, "--only", "gravity_tilt"]):
        assert main(command) == 0
        assert capsys.readouterr().out.startswith("The recording seems to be read wrongly: pose 6 does not belong")
        assert main([*command, "--read", "pose_outlier"]) == 0
        assert "Read so that pose 6 does not belong" in capsys.readouterr().out
