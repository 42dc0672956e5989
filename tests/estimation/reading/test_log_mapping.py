"""Columns: maps, units, forms of orientation, presets of headerless files; what is in doubt is asked for."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import constants
from scipy.spatial.transform import Rotation

from estimation.reading.column_map import ColumnMap, name_and_unit
from estimation.reading.column_pattern import PRESETS, Quantity
from estimation.reading.column_recognition import nearest_vector
from estimation.reading.log_reader import LogTable
from estimation.reading.log_reading import imported, read
from estimation.recordings.reading_report import StepKind
from modeling.errors import InputError
from modeling.rig import Rig
from tests.shared.log_files import (
    CHANNELS,
    POSITION,
    QUATERNION,
    Frame,
    headerless,
    in_base_axes,
    matrices,
    original,
    rotations,
)
from truewrench.options import PRESETS as LISTED

pytest.importorskip("mujoco")


def renamed(frame: Frame, folder: Path, names: Mapping[str, str] | None = None, file: str = "log.csv") -> Path:
    """A CSV with names that mean nothing: a, b, c, .. but for those given."""
    path = folder / file
    letters = {name: f"signal {chr(97 + i)}" for i, name in enumerate(frame.columns)}
    frame.rename(columns=letters | {"time": "t"} | dict(names or {})).to_csv(path, index=False)
    return path


def same_as_original(columns: Mapping[str, np.ndarray], frame: Frame) -> None:
    for name in (*CHANNELS, *POSITION):
        np.testing.assert_allclose(columns[name], frame[name], rtol=0, atol=1e-9)
    turned = np.stack([columns[name] for name in QUATERNION], axis=1)
    np.testing.assert_allclose(np.abs((turned * frame[QUATERNION].to_numpy()).sum(axis=1)), 1.0, atol=1e-12)


# ----------------------------------------------------------------------------------------- orientation

TURN: dict[str, Callable[[Rotation], np.ndarray]] = {
    "quaternion xyzw": lambda r: r.as_quat(),
    "quaternion wxyz": lambda r: r.as_quat()[:, [3, 0, 1, 2]],
    "rotation_vector": lambda r: r.as_rotvec(),
    "euler ZYX": lambda r: r.as_euler("ZYX"),
    "euler xyz": lambda r: r.as_euler("xyz"),
    "matrix_rows": lambda r: r.as_matrix().reshape(-1, 9),
    "matrix_columns": lambda r: r.as_matrix().transpose(0, 2, 1).reshape(-1, 9),
    "matrix row-major": lambda r: np.concatenate([r.as_matrix(), np.zeros((len(r), 3, 1))], axis=2).reshape(-1, 12),
}

ANGLES = ("rotation_vector", "euler ZYX", "euler xyz")


@pytest.mark.parametrize(("form", "degrees"), [*((f, False) for f in TURN), *((f, True) for f in TURN if f in ANGLES)])
def test_a_map_states_the_orientation(form: str, degrees: bool, tmp_path: Path) -> None:
    frame = original().iloc[:100]
    values = TURN[form](rotations(frame)) * (180 / np.pi if degrees else 1.0)
    parts = {f"o{i}": column for i, column in enumerate(values.T)}
    path = renamed(frame[["time", *CHANNELS, *POSITION]].assign(**parts), tmp_path, {name: name for name in parts})
    lines = [f'{name} = "signal {chr(98 + i)}"' for i, name in enumerate([*CHANNELS, *POSITION])]
    lines += [f"orientation_columns = {list(parts)}", f'orientation = "{form}"', 'time = "t"']
    lines += ['units = { angle = "deg" }'] * degrees
    stated = tmp_path / "map.toml"
    stated.write_text("\n".join(lines))
    same_as_original(imported(path, map=stated).columns, frame)


def test_the_order_of_a_matrix_is_seen_in_it(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    for order in ((0, 1, 2), (0, 2, 1)):
        values = matrices(frame).transpose(order).reshape(-1, 16)
        path = tmp_path / "log.csv"
        named = {f"ee_pose[{i}]": values[:, i] for i in range(16)}
        frame[["time", *CHANNELS]].rename(columns={"time": "t"}).assign(**named).to_csv(path, index=False)
        same_as_original(imported(path).columns, frame)


def test_a_wrench_in_base_axes_is_turned(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    path = tmp_path / "log.csv"
    in_base_axes(frame).rename(columns={"time": "t"}).to_csv(path, index=False)
    found = imported(path, map=ColumnMap.of({"wrench_axes": "base"}))
    same_as_original(found.columns, frame)


# ----------------------------------------------------------------------------------------------- units


def test_units_of_names_and_of_maps(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    scaled = frame.assign(px=frame["px"] * 1e3, py=frame["py"] * 1e3, pz=frame["pz"] * 1e3, tx=frame["tx"] * 1e3)
    scaled = scaled.assign(ty=frame["ty"] * 1e3, tz=frame["tz"] * 1e3, time=frame["time"] * 1e3)
    names = {p: f"{p[1]}_mm" for p in POSITION} | {t: f"{t.upper()} [N mm]" for t in CHANNELS[3:]} | {"time": "t (ms)"}
    path = tmp_path / "log.csv"
    scaled.rename(columns=names).to_csv(path, index=False)
    same_as_original(imported(path).columns, frame)
    scaled.rename(columns={"time": "t"}).to_csv(path, index=False)
    units = {"time": "ms", "position": "mm", "torque": "N mm"}
    same_as_original(imported(path, map=ColumnMap.of({"units": units})).columns, frame)


def in_si(unit: str) -> float:
    """The size of a unit in SI, of CODATA's and by prefixes, independent of what is tested."""
    known = {
        "N": 1.0,
        "kgf": constants.kilogram_force,
        "gf": constants.kilogram_force * constants.milli,
        "lbf": constants.pound_force,
        "ozf": constants.pound_force / 16,
        "sec": 1.0,
        "deg": constants.degree,
    }
    known |= {"m": 1.0, "in": constants.inch, "ft": constants.foot, "s": 1.0, "rad": 1.0, "°": constants.degree}
    prefixes = {"m": constants.milli, "c": constants.centi, "k": constants.kilo, "u": constants.micro}
    prefixes |= {"µ": constants.micro, "n": constants.nano}
    parts = [known[part] if part in known else prefixes[part[0]] * known[part[1:]] for part in unit.split()]
    return float(np.prod(parts))


@pytest.mark.parametrize("kind", ["time", "position", "angle", "force", "torque"])
def test_every_unit_that_a_message_names_is_known(kind: str) -> None:
    """With the factors of CODATA, however they are joined, and in the header of a column too."""
    with pytest.raises(InputError) as caught:
        ColumnMap.of({"units": {kind: "fathom"}})
    named = caught.value.remedy.removeprefix("use one of ").split(", ")
    assert len(named) >= 4
    for unit in named:
        joined = {unit.replace(" ", joint) for joint in ("", " ", ".", "*", "·", "-", "_", "×")}
        for spelling in {*joined, *(text.upper() for text in joined)}:
            factor = ColumnMap.of({"units": {kind: spelling}}).factor(kind)
            assert factor == pytest.approx(in_si(unit), rel=1e-15)
            assert name_and_unit(f"Tx ({spelling})")[0] == "Tx"


@pytest.mark.parametrize("unit", ["lbf-in", "in-lbf", "lbf.in", "lbf*in", "in.lbf", "in-lb", "lb-in", "in lbs"])
def test_an_inch_pound_has_many_spellings(unit: str) -> None:
    factor = ColumnMap.of({"units": {"torque": unit}}).factor("torque")
    assert factor == pytest.approx(constants.pound_force * constants.inch, rel=1e-15)


HEADERS = {
    "Tx_in_lbf": ("Tx", "torque", "lbf in"), "Tx_inlb": ("Tx", "torque", "lbf in"),
    "Tx [oz-in]": ("Tx", "torque", "ozf in"), "Tx[kgf.cm]": ("Tx", "torque", "kgf cm"),
    "Tx_kgfcm": ("Tx", "torque", "kgf cm"), "Tx_N.mm": ("Tx", "torque", "N mm"),
    "Tx_N_mm": ("Tx", "torque", "N mm"), "Tx_mNm": ("Tx", "torque", "mN m"), "Tx (lb*ft)": ("Tx", "torque", "lbf ft"),
    "Fx_kg": ("Fx", "force", "kgf"), "Fx / lbf": ("Fx", "force", "lbf"), "Fx, N": ("Fx", "force", "N"),
    "Fx N": ("Fx", "force", "N"), "Fx {ozf}": ("Fx", "force", "ozf"), "time [msec]": ("time", "time", "ms"),
    "t_usec": ("t", "time", "us"), "q1 [degrees]": ("q1", "angle", "deg"), "x(inch)": ("x", "position", "in"),
    "px_mm": ("px", "position", "mm"), "x (feet)": ("x", "position", "ft"),
}  # fmt: skip
PLAIN = (
    "Fx_ft", "fx_second", "/wrench/wrench/force/x", "q[0]", "O_T_EE[0]", "actual_q_0", "header.stamp.nsec", "pose/x,y",
    "n", "time", "wrench_g", "ft",
)  # fmt: skip


@pytest.mark.parametrize("header", HEADERS)
def test_units_in_headers(header: str) -> None:
    name, kind, unit = HEADERS[header]
    bare, spelled = name_and_unit(header)
    assert bare == name
    assert ColumnMap.of({"units": {kind: spelled}}).factor(kind) == pytest.approx(in_si(unit), rel=1e-15)


@pytest.mark.parametrize("name", PLAIN)
def test_no_unit_is_read_into_a_name(name: str) -> None:
    assert name_and_unit(name) == (name, None)


def test_a_unit_of_force_is_none_of_torque() -> None:
    """`mN`, with its m forgotten, is no metre-newton."""
    with pytest.raises(InputError, match="torque = 'mN' is not known"):
        ColumnMap.of({"units": {"torque": "mN"}})


@pytest.mark.parametrize("names", ["{}({})", "{} [{}]", "{}_{}"])
def test_pounds_in_headers_and_in_maps(names: str, tmp_path: Path) -> None:
    frame, path = original().iloc[:100], tmp_path / "log.csv"
    units = dict.fromkeys(CHANNELS[:3], "lbf") | dict.fromkeys(CHANNELS[3:], "lbf-in" if "(" in names else "lbf_in")
    pounds = frame.assign(**{c: frame[c] / in_si(re.sub("[-_]", " ", unit)) for c, unit in units.items()})
    header = {channel: names.format(channel.title(), unit) for channel, unit in units.items()}
    pounds.rename(columns=header | {"time": "t"}).to_csv(path, index=False)
    same_as_original(imported(path).columns, frame)
    stated = {"wrench": [header[c] for c in CHANNELS], "units": {"force": "lbf", "torque": "lbf.in"}}
    same_as_original(imported(path, map=ColumnMap.of(stated)).columns, frame)


def test_millimetres_and_degrees_are_recognised(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    path = tmp_path / "log.csv"
    shifted = frame.assign(**{name: (frame[name] + 0.5) * 1e3 for name in POSITION}).rename(columns={"time": "t"})
    shifted.to_csv(path, index=False)
    found = imported(path)
    np.testing.assert_allclose(found.columns["px"], frame["px"] + 0.5, atol=1e-9)
    assert any("taken as millimetres" in step.what for step in found.report.of(StepKind.MENDED))
    joints = frame[["time", *CHANNELS]].rename(columns={"time": "t"}).assign(q1=np.linspace(-90, 90, 100), q2=30.0)
    joints.to_csv(path, index=False)
    found = imported(path)
    np.testing.assert_allclose(found.columns["q1"], np.linspace(-np.pi / 2, np.pi / 2, 100), atol=1e-12)
    assert any("taken as degrees" in step.what for step in found.report.of(StepKind.MENDED))


@pytest.mark.parametrize(
    ("lacking", "said"),
    [
        ("ft_raw_wrench_5", r"no wrench .*beside ft_raw_wrench_0 \.\. ft_raw_wrench_4, ft_raw_wrench_5 is missing"),
        ("actual_TCP_pose_3", r"no motion .*beside actual_TCP_pose_0 .*, actual_TCP_pose_3 is missing; .*orientation"),
    ],
)
def test_a_column_that_lacks_is_named(tmp_path: Path, lacking: str, said: str) -> None:
    names = [f"{stem}_{i}" for stem in ("actual_TCP_pose", "ft_raw_wrench") for i in range(6)]
    table = pd.DataFrame(np.random.default_rng(1).normal(size=(50, 12)), columns=names)
    table.insert(0, "timestamp", np.arange(50) / 100)
    table.drop(columns=lacking).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=said):
        imported(tmp_path / "log.csv")


def test_an_axis_of_a_force_that_lacks_is_named() -> None:
    columns = dict.fromkeys(("force.x", "force.z", "torque.x", "torque.y", "torque.z"), np.zeros(3))
    found = nearest_vector([LogTable(name="log.csv", kind="text", columns=columns)], (Quantity.WRENCH,))
    assert found is not None
    assert found.missing == ("force.y",)


# ---------------------------------------------------------------------------------------- files, presets


def test_headerless_by_a_preset(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    paths = headerless(frame, tmp_path)
    same_as_original(imported(*paths, preset="xyz_quaternion_wrench").columns, frame)
    with pytest.raises(InputError, match=r"no wrench is recognised among column_1.*--map"):
        imported(*paths)


@pytest.mark.parametrize(
    ("present", "lacks"),
    [
        (("fx", "fy"), "beside fx, fy it lacks tau, or fz, tx, ty, tz in six axes"),
        (("fx", "fy", "fz", "tx", "ty"), "beside fx, fy, fz, tx, ty it lacks tz"),
    ],
)
def test_what_of_a_wrench_is_missing_is_said(tmp_path: Path, present: tuple[str, ...], lacks: str) -> None:
    path = tmp_path / "log.csv"
    original().iloc[:100][["time", *present]].to_csv(path, index=False)
    with pytest.raises(InputError, match=f"{lacks}; name its columns in a map"):
        imported(path)


def test_joints_in_degrees_with_comma_and_space(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    path = tmp_path / "log.txt"
    degrees = np.degrees(np.sin(frame["time"].to_numpy()))
    rows = zip(degrees, *(frame[c] for c in CHANNELS), strict=True)
    path.write_text("\n".join(f"{q:.9f}, {q + 5:.9f} " + " ".join(f"{w:.9f}" for w in wrench) for q, *wrench in rows))
    found = imported(path, preset="joints_deg_wrench", map=ColumnMap.of({"rate": 250}))
    np.testing.assert_allclose(found.columns["q1"], np.sin(frame["time"]), atol=1e-9)
    np.testing.assert_allclose(found.columns["tz"], frame["tz"], atol=1e-9)
    assert found.report.rate == pytest.approx(250)


def test_kinova_three_files(tmp_path: Path) -> None:
    frame = original()
    angles = np.sin(np.outer(frame["time"], np.arange(1, 8)))
    parts: dict[str, Any] = {"joint_positions.csv": angles, "wrench.csv": frame[CHANNELS]}
    parts |= {"time.csv": frame[["time"]].to_numpy() + 5.0}
    for name, values in parts.items():
        np.savetxt(tmp_path / name, values, delimiter=",")
    found = imported(*(tmp_path / name for name in parts))
    np.testing.assert_allclose(found.columns["fx"], frame["fx"], atol=1e-12)
    np.testing.assert_allclose(found.columns["q7"], np.sin(7 * frame["time"]), atol=1e-12)
    assert found.report.samples == 2500


def test_joint_states_of_two_publishers(tmp_path: Path) -> None:
    """One topic, each message with some of the joints, in turn; the rig's order of the joints counts."""
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag

    from tests.shared.log_files import ros_messages, ros_types, write_messages

    frame = original().iloc[:500]
    store = ros_types()[0]
    state = store.types["sensor_msgs/msg/JointState"]

    def messages() -> Iterator[Any]:
        for topic, kind, stamp, message in ros_messages(store.types, frame):
            yield topic, kind, stamp, message
            if "pose" in topic:
                t = message.header.stamp.sec % 1000 + message.header.stamp.nanosec * 1e-9
                for names in (["elbow", "base"], ["wrist"]):
                    angles = np.array([np.sin(t + len(name)) for name in names])
                    empty = np.zeros(0)
                    yield (
                        "/joint_states",
                        "sensor_msgs/msg/JointState",
                        stamp,
                        state(message.header, names, angles, empty, empty),
                    )

    with Bag(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        write_messages(writer, store, messages())
    stated = ColumnMap.of({"q1": "joint:base", "q2": "joint:elbow", "q3": "joint:wrist"})
    with pytest.raises(InputError, match="different sources"):
        imported(tmp_path / "bag", map=stated)
    found = imported(tmp_path / "bag", rig=_three_joints(tmp_path))
    t = found.columns["time"] + (1_760_000_000 % 1000)
    for name, joint in (("q1", "base"), ("q2", "elbow"), ("q3", "wrist")):
        np.testing.assert_allclose(found.columns[name][:-3], np.sin(t + len(joint))[:-3], atol=1e-6)


def _three_joints(folder: Path) -> Rig:
    joints = ["base", "elbow", "wrist"]
    links = "".join(f'<link name="l{i}"/>' for i in range(4))
    text = "".join(
        f'<joint name="{name}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{i % 2} {1 - i % 2} 0"/></joint>'
        for i, name in enumerate(joints)
    )
    (folder / "arm.urdf").write_text(f'<robot name="arm">{links}{text}</robot>')
    return Rig.from_data({"robot": {"urdf": str(folder / "arm.urdf"), "sensor_frame": "l3"}})


def test_the_rig_names_columns(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    names = {name: name.upper() + "!" for name in (*CHANNELS, *QUATERNION, *POSITION)}
    path = renamed(frame, tmp_path, names)
    rig = Rig.from_data({"columns": {**names, "temperature": "signal o", "time": "t"}})
    recording = read(path, rig=rig)
    same_as_original({**dict(zip(CHANNELS, recording.wrench.T, strict=True)), **recording.columns}, frame)
    again = Rig.from_data(rig.to_data())
    assert again.columns == rig.columns


@pytest.mark.parametrize(
    "names", [("pose.position", "pose.orientation"), ("transform.translation", "transform.rotation")]
)
def test_a_position_is_never_the_orientation_s_vector(names: tuple[str, str], tmp_path: Path) -> None:
    """Whichever is first in the file."""
    frame = original(500)
    position, orientation = (
        {f"{letter}{axis}": f"{name}.{axis}" for axis in axes}
        for letter, name, axes in zip("pq", names, ("xyz", "xyzw"), strict=True)
    )
    for order in ((orientation, position), (position, orientation)):
        columns = ["time", *order[0], *order[1], *CHANNELS]
        frame[columns].rename(columns=position | orientation).to_csv(tmp_path / "log.csv", index=False)
        log = imported(tmp_path / "log.csv")
        for column in POSITION:
            np.testing.assert_allclose(log.columns[column], frame[column], atol=1e-9)


def test_unknown_columns_are_kept_under_harmless_names(tmp_path: Path) -> None:
    """`wx` of an unknown log is not taken for an angular velocity in the sensor frame."""
    frame = original().iloc[:100].assign(wx=np.arange(100.0), speed=np.arange(100.0), note="fine", same=3.0)
    path = tmp_path / "log.csv"
    frame.rename(
        columns={"fx": "Force X", "fy": "Force Y", "fz": "Force Z"} | {f"t{a}": f"Torque {a}" for a in "xyz"}
    ).to_csv(path, index=False)
    columns = imported(path).columns
    assert {"log_wx", "speed", "temperature"} <= set(columns)
    assert not {"wx", "note", "same"} & set(columns)


def test_a_damaged_number_of_an_unknown_column_is_interpolated(tmp_path: Path) -> None:
    """What is written is read again, where numbers as large are refused."""
    temperature = np.linspace(20.0, 21.0, 100)
    frame = original().iloc[:100].assign(temperature=np.where(np.arange(100) == 50, -1e300, temperature), bad=1e300)
    path = tmp_path / "log.csv"
    frame.rename(columns={"time": "t"}).to_csv(path, index=False)
    found = imported(path)
    np.testing.assert_allclose(found.columns["temperature"], temperature, rtol=0, atol=1e-9)
    assert "bad" not in found.columns
    said = "numbers of temperature beyond 1e+20 taken as missing (1 of 100)"
    assert any(said in str(step) for step in found.report.of(StepKind.MENDED))


# --------------------------------------------------------------------------------------------- in doubt

MAPS: dict[str, tuple[str, str]] = {
    "no TOML": ("fx = ", "not a TOML file"),
    "no such column": ('time = "clock"', "no column 'clock'"),
    "half a wrench": ('fx = "fx"\nfy = "fy"', "not fz"),
    "no form": ('orientation = "wyzx"', "is no form"),
    "no unit": ('units = { time = "h" }', "units.time = 'h' is not known"),
    "no kind": ('units = { mass = "g" }', "is no kind of unit"),
    "no axes": ('wrench_axes = "tool"', "wrench_axes"),
    "no rate": ("rate = -5", "rate"),
    "no text": ("fx = 3", "not the name of a column"),
    "too few": ('wrench = ["fx", "fy"]', "has 2 columns"),
    "a list under another name": (
        'wrnch = ["a", "b", "c", "d", "e", "f"]',
        "no name of a list of columns; did you mean wrench",
    ),
    "bad count": ('orientation_columns = ["qx", "qy", "qz"]', "3 columns of orientation"),
}


@pytest.mark.parametrize("case", MAPS)
def test_a_wrong_map_is_explained(case: str, tmp_path: Path) -> None:
    text, message = MAPS[case]
    stated, path = tmp_path / "map.toml", tmp_path / "log.csv"
    stated.write_text(text)
    original().iloc[:50].to_csv(path, index=False)
    with pytest.raises(InputError) as caught:
        imported(path, map=stated)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_readings_are_asked_for(tmp_path: Path) -> None:
    frame = original().iloc[:50].rename(columns={"time": "t"})
    twice = frame.assign(**{f"left.{c}": frame[c] for c in CHANNELS}).rename(
        columns={c: f"right.{c}" for c in CHANNELS}
    )
    path = tmp_path / "log.csv"
    twice.to_csv(path, index=False)
    with pytest.raises(InputError, match=r"could be right.fx .. right.tz .* or left.fx .. left.tz"):
        imported(path)
    stated = {c: f"left.{c}" for c in CHANNELS}
    np.testing.assert_allclose(imported(path, map=ColumnMap.of(stated)).columns["fx"], frame["fx"])


def test_a_run_without_time_is_no_list_of_poses(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    original().drop(columns="time").rename(columns={"fx": "Fx"}).to_csv(path, index=False)
    with pytest.raises(InputError, match="a run without its time, not poses at rest"):
        imported(path)
    assert imported(path, map=ColumnMap.of({"rate": 250})).report.rate == pytest.approx(250)
    original().drop(columns="time").rename(columns={"fx": "Fx"}).iloc[::100].to_csv(path, index=False)
    found = imported(path)
    assert found.report.rate is None
    assert found.recording().at_rest


def test_the_commands_presets_are_the_librarys() -> None:
    """The command line lists them without importing the library."""
    assert tuple(PRESETS) == LISTED
    with pytest.raises(InputError, match="no preset 'kuka'"):
        imported("x.csv", preset="kuka")


@pytest.mark.parametrize("preset", ["ur_rtde", "franka", "plotjuggler", "ros_bag", "ros_csv", "kinova"])
def test_a_preset_that_does_not_fit_is_refused(preset: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    original().iloc[:100].rename(columns={"time": "stamp"}).to_csv(path, index=False)
    with pytest.raises(InputError, match=f"the preset {preset} .* does not fit: the columns are stamp, "):
        imported(path, preset=preset)


def test_a_time_that_decreases_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    original().iloc[99::-1].rename(columns={"time": "stamp"}).to_csv(path, index=False)
    with pytest.raises(InputError, match="column stamp decreases from row to row"):
        imported(path)


@pytest.mark.parametrize(("unit", "doubted"), [("deg", True), ("rad", False)])
def test_radians_stated_as_degrees_are_suspicious(unit: str, doubted: bool, tmp_path: Path) -> None:
    frame = original().iloc[:400]
    angles = dict(zip(("a", "b", "c"), rotations(frame).as_euler("ZYX").T, strict=True))
    path, stated = tmp_path / "log.csv", tmp_path / "map.toml"
    frame.drop(columns=QUATERNION).assign(**angles).to_csv(path, index=False)
    text = 'orientation = "euler ZYX"\norientation_columns = ["a", "b", "c"]\nunits = { angle = "%s" }\n'
    stated.write_text(text % unit)
    said = "\n".join(map(str, imported(path, map=stated).report.of(StepKind.SUSPICIOUS)))
    assert ("stated as degrees, hardly move the sensor: radians?" in said) is doubted
