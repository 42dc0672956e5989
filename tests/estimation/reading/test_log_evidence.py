"""Mistakes in frames are recognised by what the weight shows, and none is invented in what is right."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimation.case import Case
from estimation.fit import fit
from estimation.reading.column_map import ColumnMap
from estimation.reading.frame_check import LEAST_SHARE, ROLLED, deviations
from estimation.reading.frame_evidence import FrameEvidence, frame_evidence, sampled_rows
from estimation.reading.log_import import ImportedRecording
from estimation.reading.log_reader import Array
from estimation.reading.log_reading import imported
from estimation.readings.doubted_reading import DoubtedReading
from estimation.recordings.reading_report import StepKind
from modeling.chain.model import spatial
from modeling.errors import InputError
from tests.shared.log_files import CHANNELS, QUATERNION, Frame, original, w_first
from tests.shared.places import AIS2202, DATA, needs
from truewrench.simulated_rig import HIDDEN_EFFECTS, SpatialRig, simulate, static_poses

pytest.importorskip("mujoco")

needs_data = needs(DATA)
Columns = Mapping[str, Array]
FORCES = CHANNELS[:3]


@cache
def frame_of(name: str) -> Frame:
    """A run, one of another motion, poses, and measured poses where they are."""
    if name == "poses":
        return static_poses(SpatialRig(), 24, seed=3)
    if name == "measured":
        return pd.read_csv(AIS2202 / "calibration_poses.csv")
    if name == "run":
        return original()
    rig, hidden = SpatialRig(), [HIDDEN_EFFECTS[name]]
    return simulate(rig, rig.random_motion(seed=2), hidden=hidden, repeats=1, samples_per_period=500, seed=2)


def columns_of(name: str) -> dict[str, Array]:
    frame = frame_of(name)
    return {str(column): frame[column].to_numpy(copy=True) for column in frame.columns}


def turn_of(columns: Columns) -> Rotation:
    return Rotation.from_quat(np.stack([columns[name] for name in QUATERNION], axis=1))


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
    "sideways": (sideways, "gravity points along -y of the base"),
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
    if mistake == "sideways" and "time" not in right:  # poses: with the opposite sign of the readings it is along y
        assert wrong.best.meaning.replace("-y", "y").startswith("gravity points along y of the base (or opposite,")
    else:
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
    (doubted,) = Case.of(spatial(), [imported(path).recording()]).readings
    assert (doubted.id, doubted.value, doubted.adopted) == ("orientation_order", "wxyz", False)
    assert 'orientation = "wxyz" in a map' in doubted.statement
    right = imported(path, map=ColumnMap.of({"orientation": "wxyz"}))
    assert not right.report.of(StepKind.SUSPICIOUS)
    numbered = named.rename(columns={name: f"quat[{i}]" for i, name in enumerate(QUATERNION)})
    numbered.to_csv(path, index=False)
    taken = imported(path)
    assert any("taken so" in step.what for step in taken.report.of(StepKind.MENDED))
    (doubted,) = Case.of(spatial(), [taken.recording()]).readings
    assert (doubted.id, doubted.value, doubted.adopted) == ("orientation_order", "wxyz", True)
    for found in (right, taken):
        turned = np.stack([found.columns[name] for name in QUATERNION], axis=1)
        np.testing.assert_allclose(np.abs((turned * frame[QUATERNION].to_numpy()).sum(axis=1)), 1.0, atol=1e-12)


def test_contact_is_noticed_where_it_is() -> None:
    """Within the push (that of the simulator) nearly all samples deviate, outside hardly any, and the mass is right."""
    columns = columns_of("contact_event")
    start = 0.55 * 5.0  # of the simulator's push, which lasts a tenth of the motion
    found = deviations(columns)
    assert found is not None
    rows, time = sampled_rows(columns), columns["time"]
    inside = (time >= start) & (time <= start + 0.5)
    near = (time >= start - 0.1) & (time <= start + 0.6)
    assert found.outlying[inside[rows]].mean() > 0.9
    assert not found.outlying[~near[rows]].any()
    assert found.mass == pytest.approx(SpatialRig().mass, rel=0.05)


@pytest.mark.parametrize("name", ["run", "viscous_drag", "sensor_crosstalk"])
def test_no_contact_is_invented(name: str) -> None:
    """An effect that acts all the time is none; beyond six std is not one normal sample in ten millions."""
    found = deviations(columns_of(name))
    assert found is not None
    assert found.share < LEAST_SHARE / 2


def numbered(columns: Columns, folder: Path) -> Path:
    """A log whose names do not tell the order of the quaternion."""
    path = folder / "log.csv"
    named = {f"quat[{QUATERNION.index(n)}]" if n in QUATERNION else n: column for n, column in columns.items()}
    pd.DataFrame(named).rename(columns={"time": "stamp"}).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("name", ["run", "viscous_drag"])
def test_an_order_that_the_weight_confirms_is_no_suspicion(name: str, tmp_path: Path) -> None:
    report = imported(numbered(columns_of(name), tmp_path)).report
    assert not report.of(StepKind.SUSPICIOUS)
    assert not report.of(StepKind.MENDED)


def turned_about_y(mounted: float) -> dict[str, Array]:
    """A weight of 1 kg that turns about y alone, in a sensor that is mounted turned about z, deg."""
    time = np.arange(1000) * 0.01
    turn = Rotation.from_rotvec(np.outer(np.radians(80) * np.sin(time), [0, 1, 0]))
    mounting = Rotation.from_euler("z", mounted, degrees=True)
    force = (turn * mounting).inv().apply([0, 0, 9.806]) + np.random.default_rng(0).normal(0, 0.05, (1000, 3))
    return {
        "time": time,
        **dict(zip(QUATERNION, turn.as_quat().T, strict=True)),
        **dict(zip(FORCES, force.T, strict=True)),
        **dict.fromkeys(CHANNELS[3:], np.sin(time)),
    }


def test_an_order_that_is_in_doubt_is_asked_for(tmp_path: Path) -> None:
    """About one axis either order fits with some mounting; after a position x y z w is usual, and only doubted."""
    columns = turned_about_y(180.0)
    with pytest.raises(InputError, match=r"could be x y z w \(mass 1 kg, .*\) or w x y z \(mass 1 kg"):
        imported(numbered(columns, tmp_path))
    stated = imported(numbered(columns, tmp_path), map=ColumnMap.of({"orientation": "xyzw"}))
    assert not stated.report.of(StepKind.SUSPICIOUS)
    poses = {f"pose[{i}]": columns.pop(name) for i, name in enumerate(QUATERNION, 3)}
    place = {f"pose[{i}]": np.zeros(1000) for i in range(3)}
    found = imported(numbered({**columns, **place, **poses}, tmp_path))
    assert "nothing states the order of the quaternion, x y z w is assumed" in suspicions(found)


# ------------------------------------------------------------------------------------- measured recordings


@cache
def peeling(arm: int, demonstration: int, form: str | None = "wxyz") -> ImportedRecording:
    """One arm of one demonstration: 26 rows, 13 an arm, in a cell of matrices without names."""
    columns = {"position": range(3), "orientation_columns": range(3, 7), "wrench": range(7, 13)}
    first = 13 * (arm - 1)
    stated: dict[str, object] = {
        key: [f"Data_noObj{{{demonstration}}}[{first + i}]" for i in places] for key, places in columns.items()
    }
    stated |= {"rate": 100} if form is None else {"rate": 100, "orientation": form}
    return imported(DATA / "lasa_peeling" / "proc-data-noObj.mat", map=ColumnMap.of(stated))


def suspicions(found: ImportedRecording) -> str:
    return "\n".join(step.what for step in found.report.of(StepKind.SUSPICIOUS))


def weighed(columns: Columns, kept: float = 1.0) -> tuple[float, float]:
    """Mass (kg) and rms (N) by least squares of f = -m g + b; without the loudest samples, of which `kept` are left."""
    down = turn_of(columns).inv().apply([0, 0, -9.806])
    force = np.stack([columns[name] for name in FORCES], axis=1)
    quiet, mass, squares = np.ones(len(force), dtype=bool), 0.0, np.zeros(len(force))
    for _ in range(50):
        moved, pulled = (part - part[quiet].mean(axis=0) for part in (down, force))
        mass = float((moved[quiet] * pulled[quiet]).sum() / (moved[quiet] ** 2).sum())
        squares = ((pulled - mass * moved) ** 2).sum(axis=1)
        before, quiet = quiet, squares <= np.quantile(squares, kept)
        if (before == quiet).all():
            break
    return mass, float(np.sqrt(squares[quiet].mean() / 3))


@needs_data
def test_the_peeling_file_has_no_names() -> None:
    with pytest.raises(InputError, match=r"no wrench is recognised among Data_noObj\{1\}\[0\].* name its columns"):
        imported(DATA / "lasa_peeling" / "proc-data-noObj.mat")


@pytest.mark.long
@needs_data
@pytest.mark.parametrize(("demonstration", "plain", "quiet"), [(1, 1.520, 1.498), (2, 1.660, 1.520)])
def test_the_arm_that_holds_the_vegetable(demonstration: int, plain: float, quiet: float) -> None:
    """Known by hand: 1.52 and 1.66 kg by least squares, 1.50 and 1.52 of the quieter samples; knife and hand touch it.

    As x y z w, as the authors wrote, the weight does not fit.
    """
    found = peeling(2, demonstration)
    assert weighed(found.columns)[0] == pytest.approx(plain, abs=1e-3)
    assert weighed(found.columns, 0.4)[0] == pytest.approx(quiet, abs=1e-3)
    assert "contact, or another effect that is strongest then; the rest shows a tool of about 1.5 kg" in suspicions(
        found
    )
    deviating = deviations(found.columns)
    assert deviating is not None
    assert deviating.mass == pytest.approx(quiet, abs=0.02)
    w_last = {**found.columns, **{new: found.columns[old] for new, old in ROLLED}}
    assert weighed(w_last)[1] > 2 * weighed(found.columns)[1]
    with pytest.raises(InputError, match=r"could be x y z w .* or w x y z \(mass 1\.[56]"):
        peeling(2, demonstration, None)


@needs_data
@pytest.mark.parametrize("demonstration", [pytest.param(1, marks=pytest.mark.long), 2])
def test_the_arm_that_peels(demonstration: int) -> None:
    """Known: compensated already. Contact is where the authors' label says peeling (3), none where the arm is free."""
    from scipy.io import loadmat

    found = peeling(1, demonstration)
    said = suspicions(found)
    assert "compensated already" in said
    assert "contact, or another effect" in said
    assert "the rest shows a tool" not in said
    labels = loadmat(DATA / "lasa_peeling" / "proc-data-noObj.mat", squeeze_me=True)["True_states_noObj"]
    label = labels[demonstration - 1]
    deviating = deviations(found.columns)
    assert deviating is not None
    assert deviating.outlying[label == 3].mean() > 0.85
    assert deviating.outlying[(label == 1) | (label == 5)].mean() < 0.05


@needs_data
@pytest.mark.parametrize("name", ["peg", "contour"])
def test_the_hand_held_tool(name: str) -> None:
    """Known: the pose repeats in more than nine rows of ten, the wrench in half or more; a tracker of 30 Hz; contact.

    The tool hardly turns, so that neither order nor mass can be told, and neither is claimed.
    """
    found = imported(DATA / "handheld_jr3" / f"{name}_data_demo_a_1.dat")
    report = found.report
    mended = "\n".join(step.what for step in report.of(StepKind.MENDED))
    assert "wrench held for" in mended
    assert "pose held for" in mended
    assert report.rate == pytest.approx(200, rel=1e-3)
    assert report.clocks[1].rate == pytest.approx(30, rel=1e-3)
    said = suspicions(found)
    assert "x y z w is assumed, and the weight does not confirm it" in said
    assert ("contact, or another effect" if name == "contour" else "the sensor hardly turns") in said
    assert "the rest shows a tool" not in said
    with pytest.raises(InputError, match="the sign convention cannot be decided"):
        fit(spatial(), found.recording())


@needs_data
@pytest.mark.parametrize(("name", "deviates"), [("baseline", False), ("vibrations", True), ("contact", True)])
def test_the_arm_that_was_tapped_and_touched(name: str, deviates: bool) -> None:
    """Untouched, tapped by a hammer, touched by hand in more than half of the time; 0.934 kg by the poses."""
    said = suspicions(imported(AIS2202 / f"{name}.csv"))
    assert ("contact, or another effect" in said) == deviates
    masses = [float(mass) for mass in re.findall(r"about (\S+) kg", said)]
    assert masses == pytest.approx([0.934] * len(masses), rel=0.05)


@pytest.mark.parametrize(
    ("meant", "stated"), [("xyz", "XYZ"), ("XYZ", "xyz"), ("xyz", "ZYX"), ("ZYX", "xyz"), ("yxz", "XYZ")]
)
def test_another_convention_of_euler_angles_is_named(meant: Any, stated: str, tmp_path: Path) -> None:
    """Of all orders, about fixed axes (small letters) and moving ones, with the line of the map that states it."""
    frame = static_poses(SpatialRig(), 24, seed=3)
    angles = Rotation.from_quat(frame[QUATERNION].to_numpy(copy=True)).as_euler(meant, degrees=True)
    names = ["roll", "pitch", "yaw"]
    frame.drop(columns=QUATERNION).assign(**dict(zip(names, angles.T, strict=True))).to_csv(tmp_path / "log.csv")

    def readings(convention: str) -> tuple[DoubtedReading, ...]:
        form = {"orientation": f"euler {convention}", "orientation_columns": names, "units": {"angle": "deg"}}
        return Case.of(spatial(), [imported(tmp_path / "log.csv", map=ColumnMap.of(form)).recording()]).readings

    (doubted,) = readings(stated)
    assert (doubted.id, doubted.value) == ("euler_convention", meant)
    assert f'orientation = "euler {meant}" in a map' in doubted.statement
    assert not readings(meant)
