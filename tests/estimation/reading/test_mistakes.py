"""Each mistake of a recording's author on four recordings: recognised with the advice that mends it, none invented."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimation.case import Case
from estimation.reading.column_map import ColumnMap
from estimation.reading.log_reader import Array
from estimation.reading.log_reading import imported, read
from estimation.readings.doubted_reading import DoubtedReading
from estimation.recordings.reading_report import ReadingReport, StepKind
from estimation.recordings.sign_convention import decide_convention
from modeling.chain.model import planar as planar_model
from modeling.chain.model import spatial
from modeling.errors import InputError
from modeling.rig import Rig
from tests.shared.log_files import QUATERNION, original, w_first
from tests.shared.places import AIS2202, DATA, needs
from truewrench.command_line import main
from truewrench.simulated_rig import (
    CableSpring,
    ContactEvent,
    GravityTilt,
    PlanarRig,
    SensorLag,
    SpatialRig,
    ViscousDrag,
    simulate,
    static_poses,
)

pytest.importorskip("mujoco")

needs_data = needs(DATA)
PLANE, SPACE = PlanarRig(), SpatialRig()
ARM = Rig(link_lengths=PLANE.link_lengths, gravity=PLANE.gravity)
GRAVITY = 9.806
Columns = Mapping[str, Array]
FORCES, TORQUES, POSITION = ("fx", "fy", "fz"), ("tx", "ty", "tz"), ("px", "py", "pz")
HIDDEN = {
    "drag": ViscousDrag(),
    "tether": CableSpring(),
    "tilt": GravityTilt(),
    "lag": SensorLag(),
    "push": ContactEvent(),
}


@cache
def frame_of(name: str) -> pd.DataFrame:
    """A planar run, a run in six axes with a hidden drag, simulated poses, measured poses; or with what else acts."""
    if name == "planar":
        return simulate(PLANE, PLANE.random_motion(seed=4), repeats=2, samples_per_period=500, seed=4)
    if name == "six axes":
        return original()
    if name == "poses":
        return static_poses(SPACE, 24, seed=3)
    if name == "measured":
        return pd.read_csv(AIS2202 / "calibration_poses.csv")
    rig = PLANE if name.startswith("planar") else SPACE
    motion, hidden = rig.random_motion(seed=7), [HIDDEN[name.split()[-1]]]
    return simulate(rig, motion, hidden=hidden, repeats=1, samples_per_period=500, seed=7)


def columns_of(name: str) -> dict[str, Array]:
    frame = frame_of(name)
    return {str(column): frame[column].to_numpy(copy=True) for column in frame.columns}


def written(columns: Columns, folder: Path) -> Path:
    path = folder / "log.csv"
    pd.DataFrame(dict(columns)).to_csv(path, index=False)
    return path


# ----------------------------------------------------------------------------------------- mistakes


def scaled(columns: Columns, names: tuple[str, ...], factor: float) -> Columns:
    return {name: column * factor if name in names else column for name, column in columns.items()}


def renamed(columns: Columns, old: str, new: str) -> Columns:
    return {new if name == old else name: column for name, column in columns.items()}


def turned(columns: Columns, *, to_base: bool = True) -> Columns:
    """The wrench along base axes; in the plane those of the readings at phi = 0 are x and -y."""
    if "phi" in columns or "q1" in columns:
        phi = columns["phi"] if "phi" in columns else sum(columns[f"q{i}"] for i in (1, 2, 3))
        along, across = columns["fx"], -columns["fy"]
        return {
            **columns,
            "fx": np.cos(phi) * along + np.sin(phi) * across,
            "fy": -np.sin(phi) * along + np.cos(phi) * across,
        }
    rotation = Rotation.from_quat(np.stack([columns[name] for name in QUATERNION], axis=1))
    found = dict(columns)
    for names in (FORCES, TORQUES):
        vectors = rotation.apply(np.stack([columns[name] for name in names], axis=1), inverse=not to_base)
        found |= dict(zip(names, vectors.T, strict=True))
    return found


def compensated(columns: Columns) -> Columns:
    """Noise about zero, as after a perfect compensation."""
    rng = np.random.default_rng(0)
    noise = {name: rng.normal(0, 0.06, len(columns["fx"])) for name in FORCES if name in columns}
    return {**columns, **noise}


def clipped(columns: Columns) -> Columns:
    return {**columns, "fy": np.minimum(columns["fy"], np.quantile(columns["fy"], 0.7))}


def stopped(columns: Columns) -> Columns:
    """A channel that keeps its value for a sixth of the rows; of poses it never changes."""
    column = columns["fx"].copy()
    rows = slice(None) if len(column) < 100 else slice(len(column) // 3, len(column) // 2)
    column[rows] = column[rows][0]
    return {**columns, "fx": column}


def with_letters(columns: Columns) -> Columns:
    """Letters O and I for the digits in one cell."""
    cells = [f"{value:.6f}" for value in columns["fx"]]
    cells[7] = "1O.I5"
    return {**columns, "fx": np.array(cells, dtype=object)}


RUNS, SPATIAL = ("planar", "six axes"), ("six axes", "poses", "measured")
EVERY = ("planar", *SPATIAL)
ANGLES = ("q1", "q2", "q3", "phi")
MISTAKES: dict[str, tuple[Callable[[Columns], Columns], tuple[str, ...], str, str]] = {
    "milliseconds": (lambda c: scaled(c, ("time",), 1e3), RUNS, "milliseconds", "units = { time = .ms. }"),
    "nanoseconds": (lambda c: scaled(c, ("time",), 1e9), RUNS, "nanoseconds", "truewrench import"),
    "%time": (lambda c: renamed(c, "time", "%time"), RUNS, "%time increases steadily", "name it time"),
    "stamp": (lambda c: renamed(c, "time", "header.stamp"), RUNS, "header.stamp increases", "name it time"),
    "no time": (lambda c: {n: v for n, v in c.items() if n != "time"}, RUNS, "a run without its time", "rate = 500"),
    "degrees": (lambda c: scaled(c, ANGLES, 180 / np.pi), ("planar",), "angles are in deg", "angle = .deg."),
    "millimetres": (lambda c: scaled(c, POSITION, 1e3), ("six axes",), "position is in mm", "position = .mm."),
    "w first": (w_first, SPATIAL, "quaternion is w x y z", "orientation = .wxyz."),
    "inverse": (lambda c: {**c, "qw": -c["qw"]}, SPATIAL, "that of the base in the sensor", "orientation_of = .base."),
    "base axes": (turned, EVERY, "along base axes|along the axes of the base", "sensor's axes|wrench_axes"),
    "compensated": (compensated, EVERY, "compensated already", "by contact"),
    "saturated": (clipped, EVERY, "fy stays at its extreme value", "saturated"),
    "stuck": (stopped, EVERY, "fx (stops|never changes)", ""),
    "letters": (with_letters, EVERY, "column fx is not a number at row 9", "make the column numeric"),
}
CASES = [
    pytest.param(mistake, name, marks=[needs_data] if name == "measured" else [])
    for mistake, (_, names, _, _) in MISTAKES.items()
    for name in names
]


def said(path: Path, *, planar: bool) -> str:
    """What is suspicious or wrong in a file of FORMATS' columns, and the readings of its case."""
    rig = ARM if planar else None
    try:
        recording = read(path, rig=rig)
    except InputError as error:
        return str(error)
    report, model = recording.reading, planar_model(rig) if planar else spatial(rig)
    readings: tuple[DoubtedReading, ...] = ()
    with suppress(InputError):
        readings = Case.of(model, [recording]).readings
    suspicious = () if report is None else report.of(StepKind.SUSPICIOUS)
    return "\n".join([*map(str, suspicious), *(doubted.sentence for doubted in readings)])


@pytest.mark.parametrize(("mistake", "name"), CASES)
def test_a_mistake_is_recognised_before_it_becomes_a_number(mistake: str, name: str, tmp_path: Path) -> None:
    change, _, meaning, advice = MISTAKES[mistake]
    text = said(written(change(columns_of(name)), tmp_path), planar=name == "planar")
    assert re.search(meaning, text), text
    assert re.search(advice, text), text


UNTOUCHED = ("planar", "six axes", "poses", *(f"{place} {what}" for place in ("planar", "space") for what in HIDDEN))


@pytest.mark.parametrize("name", UNTOUCHED)
def test_none_is_invented(name: str, tmp_path: Path) -> None:
    path = written(columns_of(name), tmp_path)
    assert said(path, planar=name.startswith("planar")) == ""


@needs_data
@pytest.mark.parametrize("name", ["calibration_poses", "baseline", "vibrations", "contact"])
def test_none_is_invented_in_what_was_measured(name: str) -> None:
    """Among them a hand on the tool and hammer taps."""
    folder = AIS2202
    assert read(folder / f"{name}.csv", rig=Rig.read(folder / "rig.toml")).reading is None


def test_a_hand_on_the_tool_is_no_mistake_of_axes(tmp_path: Path) -> None:
    """A force of half the weight for half of the time, smooth, along base axes."""
    columns = columns_of("six axes")
    instants = np.linspace(0, 1, len(columns["fx"]))
    hand = [6 * np.sin(2 * np.pi * (k + 2) * instants + k) * (np.abs(instants - 0.5) < 0.25) for k in range(3)]
    base = turned(columns)
    pushed = turned({**base, **{n: base[n] + f for n, f in zip(FORCES, hand, strict=True)}}, to_base=False)
    assert said(written(pushed, tmp_path), planar=False) == ""


# -------------------------------------------------------------------------------- what mends them


def suspicious(report: ReadingReport) -> list[str]:
    return [str(step) for step in report.of(StepKind.SUSPICIOUS)]


@pytest.mark.parametrize(
    ("mistake", "advised"),
    [
        ("w first", {"orientation": "wxyz"}),
        ("inverse", {"orientation_of": "base"}),
        ("base axes", {"wrench_axes": "base"}),
        ("millimetres", {"units": {"position": "mm"}}),
        ("milliseconds", {"units": {"time": "ms"}}),
    ],
)
def test_the_advice_mends_it(mistake: str, advised: dict[str, object], tmp_path: Path) -> None:
    right = columns_of("six axes")
    path = written(MISTAKES[mistake][0](right), tmp_path)
    found = imported(path, map=ColumnMap.of(advised))
    assert not suspicious(found.report)
    for name in (*FORCES, *POSITION, "time"):
        np.testing.assert_allclose(found.columns[name], right[name] - (name == "time") * right[name][0], atol=1e-6)
    overlap = sum(found.columns[name] * right[name] for name in QUATERNION)
    np.testing.assert_allclose(np.abs(overlap), 1.0, atol=1e-9)


def test_small_joint_angles_in_degrees_are_recognised_by_the_weight(tmp_path: Path) -> None:
    """Up to 9 degrees, which as radians would be a turn and a half."""
    rig = PlanarRig(position_limit=0.15, velocity_limit=0.3, acceleration_limit=1.0)
    frame = simulate(rig, rig.random_motion(seed=2, period=10), repeats=1, samples_per_period=1000, seed=2)
    columns = {str(name): frame[name].to_numpy(copy=True) for name in frame.columns}
    assert said(written(columns, tmp_path), planar=True) == ""
    path = written(scaled(columns, ANGLES, 180 / np.pi), tmp_path)
    assert "the angles are in deg; the mass is 0.9" in said(path, planar=True)
    # Imported likewise, though the map's author did not say it; and mended by what is advised.
    assert [(a.kind, a.value, a.adopted) for a in imported(path, rig=ARM).report.assumptions] == [
        ("angle", "deg", False)
    ]
    mended = imported(path, map=ColumnMap.of({"units": {"angle": "deg"}}), rig=ARM)
    assert not suspicious(mended.report)
    np.testing.assert_allclose(mended.columns["q1"], columns["q1"], atol=1e-9)


def test_an_inverse_homogeneous_matrix_is_inverted_with_its_position(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    turn = Rotation.from_quat(frame[list(QUATERNION)].to_numpy(copy=True))
    place = frame[list(POSITION)].to_numpy(copy=True)
    poses = np.tile(np.eye(4), (len(frame), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turn.inv().as_matrix(), -turn.apply(place, inverse=True)
    parts = {f"ee_pose[{i}]": poses.reshape(-1, 16)[:, i] for i in range(16)}
    kept = frame[["time", *FORCES, *TORQUES]].rename(columns={"time": "t"})
    path = tmp_path / "log.csv"
    kept.assign(**parts).to_csv(path, index=False)
    found = imported(path, map=ColumnMap.of({"orientation_of": "base"})).columns
    for name, column in zip(POSITION, place.T, strict=True):
        np.testing.assert_allclose(found[name], column, atol=1e-9)


@pytest.mark.parametrize("convention", ["on_tool", "on_sensor"])
def test_a_command_names_the_mistake_in_one_line(
    convention: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before what it gives, whatever sign of the weight was stated."""
    path = written(w_first(columns_of("poses")), tmp_path)
    rig = tmp_path / "rig.toml"
    rig.write_text(f'[sensor]\nconvention = "{convention}"\n')
    main(["fit", str(path), "--rig", str(rig)])
    first, *lines = capsys.readouterr().out.splitlines()
    assert "read wrongly: the quaternion is w x y z" in first
    assert "with a mass of 1.199 kg" in first
    assert not any("w x y z" in line for line in lines)


# ------------------------------------------------------------------------------------- convention


@pytest.mark.parametrize("what", HIDDEN)
def test_the_convention_is_decided_whatever_is_hidden(what: str, tmp_path: Path) -> None:
    recording = read(written(columns_of(f"space {what}"), tmp_path))
    assert decide_convention([recording], GRAVITY).convention.value == SPACE.convention


def test_an_undecided_convention_names_the_mistake(tmp_path: Path) -> None:
    recording = read(written(compensated(columns_of("six axes")), tmp_path))
    with pytest.raises(InputError, match=r"cannot be decided: at most .* is a weight .*compensated already"):
        decide_convention([recording], GRAVITY)
