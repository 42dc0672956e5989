"""Mistakes in frames are recognised by what the weight shows, and none is invented in what is right."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimation.logs.columns.column_map import ColumnMap
from estimation.logs.frame_evidence import FrameEvidence, frame_evidence
from estimation.logs.log_reading import imported
from estimation.logs.log_table import Array
from estimation.recordings.reading_report import StepKind
from tests.log_files import CHANNELS, QUATERNION, Frame, original
from truewrench.simulated_rig import HIDDEN_EFFECTS, SpatialRig, simulate, static_poses

pytest.importorskip("mujoco")

DATA = Path(os.environ.get("TRUEWRENCH_DATA") or Path(__file__).parents[2] / "shared" / "data")
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no recordings at {DATA}: set TRUEWRENCH_DATA to their folder"
)
Columns = Mapping[str, Array]
FORCES = CHANNELS[:3]


@cache
def frame_of(name: str) -> Frame:
    """A run, one of another motion, poses, and measured poses where they are."""
    if name == "poses":
        return static_poses(SpatialRig(), 24, seed=3)
    if name == "measured":
        return pd.read_csv(DATA / "ais2202" / "calibration_poses.csv")
    if name == "run":
        return original()
    rig, hidden = SpatialRig(), [HIDDEN_EFFECTS[name]]
    return simulate(rig, rig.random_motion(seed=2), hidden=hidden, repeats=1, samples_per_period=500, seed=2)


def columns_of(name: str) -> dict[str, Array]:
    frame = frame_of(name)
    return {str(column): frame[column].to_numpy(copy=True) for column in frame.columns}


def turn_of(columns: Columns) -> Rotation:
    return Rotation.from_quat(np.stack([columns[name] for name in QUATERNION], axis=1))


def w_first(columns: Columns) -> Columns:
    """What xyzw is taken for when the file has wxyz."""
    renamed = dict(zip(QUATERNION, ("qw", "qx", "qy", "qz"), strict=True))
    return {**columns, **{new: columns[old] for new, old in renamed.items()}}


def inverse(columns: Columns) -> Columns:
    return {**columns, "qw": -columns["qw"]}


def in_base(columns: Columns) -> Columns:
    turned = turn_of(columns).apply(np.stack([columns[name] for name in FORCES], axis=1))
    return {**columns, **dict(zip(FORCES, turned.T, strict=True))}


def sideways(columns: Columns) -> Columns:
    """A base whose y points up: orientation and position in its axes."""
    mounted = Rotation.from_euler("x", -90, degrees=True)
    turned = {**columns, **dict(zip(QUATERNION, (mounted * turn_of(columns)).as_quat().T, strict=True))}
    if "px" in columns:
        place = mounted.apply(np.stack([columns[name] for name in ("px", "py", "pz")], axis=1))
        turned |= dict(zip(("px", "py", "pz"), place.T, strict=True))
    return turned


MISTAKES: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "w first": (w_first, "w x y z"),
    "inverse": (inverse, "base's in the sensor"),
    "base axes": (in_base, "along base axes"),
    "sideways": (sideways, "along y of the base"),
}
RUNS = ("run", "poses", "cable_spring", "viscous_drag", "gravity_tilt", "sensor_crosstalk")
CASES = (*RUNS, pytest.param("measured", marks=needs_data))


def evidence(columns: Columns) -> FrameEvidence:
    found = frame_evidence(columns)
    assert found is not None
    return found


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("name", CASES)
def test_a_mistake_is_recognised(name: str, mistake: str) -> None:
    change, meaning = MISTAKES[mistake]
    right, wrong = columns_of(name), evidence(change(columns_of(name)))
    assert wrong.is_better
    assert meaning in wrong.best.meaning
    # Undone it is the right reading again: the same residual and mass.
    assert wrong.best.rms == pytest.approx(evidence(right).as_read.rms, rel=1e-3)
    assert wrong.best.mass == pytest.approx(0.934 if name == "measured" else SpatialRig().mass, rel=0.07)


@pytest.mark.parametrize("name", CASES)
def test_none_is_invented(name: str) -> None:
    found = evidence(columns_of(name))
    assert not found.is_better
    assert not found.shows_no_weight


@pytest.mark.parametrize("name", RUNS)
def test_compensated_readings_show_no_weight(name: str) -> None:
    columns = columns_of(name)
    noise = np.random.default_rng(0).normal(0, 0.06, (3, len(columns["fx"])))
    assert evidence({**columns, **dict(zip(FORCES, noise, strict=True))}).shows_no_weight


def test_gravity_in_too_few_directions_is_no_evidence() -> None:
    columns = columns_of("run")
    still = {name: np.full_like(columns[name], value) for name, value in zip(QUATERNION, (0, 0, 0, 1.0), strict=True)}
    assert frame_evidence({**columns, **still}) is None


def test_a_named_order_is_advised_and_an_unnamed_one_taken(tmp_path: Path) -> None:
    frame = original()
    named = frame.rename(columns={"time": "t"}).assign(
        **{n: c for n, c in w_first(columns_of("run")).items() if n in QUATERNION}
    )
    path = tmp_path / "log.csv"
    named.to_csv(path, index=False)
    said = [str(step) for step in imported(path).report.of(StepKind.SUSPICIOUS)]
    assert len(said) == 1
    assert "the quaternion is w x y z: the mass is 1.2" in said[0]
    assert 'state orientation = "wxyz" in a map' in said[0]
    right = imported(path, map=ColumnMap.of({"orientation": "wxyz"}))
    assert not right.report.of(StepKind.SUSPICIOUS)
    numbered = named.rename(columns={name: f"quat[{i}]" for i, name in enumerate(QUATERNION)})
    numbered.to_csv(path, index=False)
    taken = imported(path)
    assert any("taken so" in step.what for step in taken.report.of(StepKind.MENDED))
    for found in (right, taken):
        turned = np.stack([found.columns[name] for name in QUATERNION], axis=1)
        np.testing.assert_allclose(np.abs((turned * frame[QUATERNION].to_numpy()).sum(axis=1)), 1.0, atol=1e-12)


@needs_data
def test_the_peeling_arms(tmp_path: Path) -> None:
    """Arm 1 is compensated already (known); without a map it is asked which columns are meant."""
    cell = "Data_noObj{1}"
    columns = {"position": range(3), "orientation_columns": range(3, 7), "wrench": range(7, 13)}
    stated = {key: [f"{cell}[{i}]" for i in places] for key, places in columns.items()}
    options = ColumnMap.of({**stated, "orientation": "wxyz", "rate": 100})
    report = imported(DATA / "lasa_peeling" / "proc-data-noObj.mat", map=options).report
    assert any("compensated already" in step.what for step in report.of(StepKind.SUSPICIOUS))


@needs_data
@pytest.mark.parametrize("name", ["peg", "contour"])
def test_the_hand_held_tool(name: str) -> None:
    """Known: the pose repeats in more than nine rows of ten, the wrench in half or more; a tracker of 30 Hz."""
    report = imported(DATA / "handheld_jr3" / f"{name}_data_demo_a_1.dat").report
    said = "\n".join(step.what for step in report.of(StepKind.MENDED))
    assert "wrench held for" in said
    assert "pose held for" in said
    assert report.rate == pytest.approx(200, rel=1e-3)
    assert report.clocks[1].rate == pytest.approx(30, rel=1e-3)
