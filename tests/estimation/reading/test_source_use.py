"""Several sources: parts of one recording, or each a whole one; what is used of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.reading.column_map import ColumnMap
from estimation.reading.log_import import ImportedRecording, ReadingOptions, import_recording
from estimation.recordings.reading_report import StepKind
from modeling.errors import InputError
from tests.shared.log_files import (
    CHANNELS,
    EPOCH,
    POSITION,
    QUATERNION,
    original,
    plotjuggler,
    poses_at,
    ros_messages,
    ros_types,
    two_clocks,
    write_messages,
)

Array = NDArray[np.float64]

pytest.importorskip("mujoco")


def said(found: ImportedRecording, kind: StepKind) -> str:
    return "\n".join(map(str, found.report.of(kind)))


@pytest.mark.parametrize(("later", "how"), [(0.0, "only one of them would be used"), (100.0, "do not overlap in time")])
def test_two_whole_recordings_are_refused(later: float, how: str, tmp_path: Path) -> None:
    frame = original().iloc[:300]
    folders = [tmp_path / "monday", tmp_path / "tuesday"]
    for folder in folders:
        folder.mkdir()
    monday, tuesday = (
        plotjuggler(frame.assign(time=frame["time"] + shift), folder)[0]
        for folder, shift in zip(folders, (0.0, later), strict=True)
    )
    with pytest.raises(InputError, match="each hold a whole recording") as raised:
        import_recording([monday, tuesday])
    assert str(monday) in str(raised.value)
    assert str(tuesday) in str(raised.value)
    assert how in str(raised.value)


def test_an_unused_source_is_suspicious(tmp_path: Path) -> None:
    log = tmp_path / "temperature.csv"
    log.write_text("time,temperature\n0,20\n1,21\n2,22\n", encoding="utf-8")
    sources = two_clocks(original(), tmp_path)
    assert "nothing of this source is used" not in said(import_recording(sources), StepKind.SUSPICIOUS)
    assert f"{log}: nothing of this source is used" in said(import_recording([*sources, log]), StepKind.SUSPICIOUS)


def test_unused_sheets_of_a_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.xlsx"
    with pd.ExcelWriter(path) as writer:
        original().iloc[:300].to_excel(writer, sheet_name="run", index=False)
        pd.DataFrame({"time": [0.0, 1.0], "load": [3.0, 4.0]}).to_excel(writer, sheet_name="scales", index=False)
    found = import_recording([path])
    assert f"{path}: not used: scales" in said(found, StepKind.TAKEN)
    assert "not used: run" not in said(found, StepKind.TAKEN)


def bag_of(frame: pd.DataFrame, folder: Path, left_out: str) -> Path:
    """A ROS 2 bag without a topic, and one of another type beside the others."""
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag

    store = ros_types()[0]
    text = store.types["std_msgs/msg/String"]
    path = folder / "bag"
    with Bag(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kept = [message for message in ros_messages(store.types, frame) if left_out not in message[0]]
        write_messages(writer, store, [*kept, ("/status", "std_msgs/msg/String", kept[0][2], text(data="on"))])
    return path


def test_a_bag_without_a_wrench_names_its_topics(tmp_path: Path) -> None:
    path = bag_of(original().iloc[:50], tmp_path, "/ft/wrench")
    with pytest.raises(InputError, match="no topic of geometry_msgs/WrenchStamped; its topics are /arm/pose, /status"):
        import_recording([path])


def test_a_bag_without_a_motion_says_what_to_record(tmp_path: Path) -> None:
    """No map of columns would help."""
    path = bag_of(original().iloc[:50], tmp_path, "/arm/pose")
    with pytest.raises(InputError, match=r"its topics are /ft/wrench, /status .*record the pose of tool0") as raised:
        import_recording([path])
    assert "map" not in str(raised.value)


def test_a_log_without_a_motion_says_what_to_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    original()[["time", *CHANNELS]].to_csv(path, index=False)
    with pytest.raises(InputError, match="nothing that tells how the sensor was turned or moved; log its pose"):
        import_recording([path])


def test_a_folder_of_bags_is_answered_with_their_names(tmp_path: Path) -> None:
    path = bag_of(original().iloc[:50], tmp_path, "nothing")
    with pytest.raises(InputError, match=f"a folder without a ROS 2 bag; give the folder of a bag: {path}"):
        import_recording([tmp_path])


def test_a_truncated_bag_is_told_how_to_be_repaired(tmp_path: Path) -> None:
    (file,) = bag_of(original().iloc[:50], tmp_path, "nothing").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"[^.]; repair it \(`mcap recover`") as raised:
        import_recording([file])
    assert ".;" not in str(raised.value)


def test_an_mcap_file_of_other_messages_is_not_to_be_repaired(tmp_path: Path) -> None:
    """Its header's profile says whose messages it holds: with Foxglove's own it is empty."""
    (file,) = bag_of(original().iloc[:50], tmp_path, "nothing").glob("*.mcap")
    content = file.read_bytes()
    assert content[8:9] == b"\x01"
    for profile in ("", "other"):
        fields = len(profile).to_bytes(4, "little") + profile.encode() + (0).to_bytes(4, "little")
        header = b"\x01" + len(fields).to_bytes(8, "little") + fields
        file.write_bytes(content[:8] + header + content[17 + int.from_bytes(content[9:17], "little") :])
        with pytest.raises(InputError, match=f"messages of {profile or 'no profile'}, and not of ROS 2; export it"):
            import_recording([file])


# Bags with several wrenches and a tree of transforms.


MOUNT = Rotation.from_euler("XYZ", [0.3, -0.2, 0.9])
LEVER = np.array([0.02, -0.01, 0.1])
FLANGE = Rotation.from_euler("XYZ", [-1.2, 0.4, 2.0])
STILL = np.array([0.3, 0.1, -0.2])
RATES = {"link": 100.0, "flange": 40.0}
"""Hz: of the transforms, which no sample of the wrench (250 Hz) shares its stamp with."""
WEIGHTLESS = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])


def link(t: Array) -> tuple[Rotation, Array]:
    """A first joint that turns and slides slowly: its orientations and places at times t (n,), s."""
    turned = np.column_stack([0.4 * np.sin(0.9 * t), 0.3 * np.cos(0.7 * t), 0.5 * np.sin(0.5 * t)])
    return Rotation.from_rotvec(turned), 0.2 * np.column_stack([np.sin(t), np.cos(0.8 * t), np.sin(0.6 * t)])


class Bag:
    """A ROS 2 bag of a run: topics of wrenches in their frames, tf from base over link and flange to the sensor."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame, self.store = frame, ros_types()[0]
        self.messages: list[tuple[str, str, int, Any]] = []

    def header(self, stamp: float, name: str) -> tuple[Any, int]:
        ns = EPOCH * 10**9 + round(stamp * 1e9)
        time = self.store.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        return self.store.types["std_msgs/msg/Header"](stamp=time, frame_id=name), ns

    def add(self, topic: str, kind: str, stamp: int, **fields: Any) -> None:
        self.messages.append((topic, kind, stamp, self.store.types[kind](**fields)))

    def wrench(self, topic: str, frame_id: str, values: Array) -> Bag:
        """Readings (n, 6) at the rows of the run."""
        vector, types = self.store.types["geometry_msgs/msg/Vector3"], self.store.types
        for t, row in zip(self.frame["time"], values, strict=True):
            head, ns = self.header(t, frame_id)
            wrench = types["geometry_msgs/msg/Wrench"](force=vector(*row[:3]), torque=vector(*row[3:]))
            self.add(topic, "geometry_msgs/msg/WrenchStamped", ns + 4_000_000, header=head, wrench=wrench)
        return self

    def transforms(self, topic: str, parent: str, child: str, t: Array, turn: Rotation, place: Array) -> Bag:
        """Poses of the child in the parent at times t (n,)."""
        types = self.store.types
        for stamp, q, p in zip(t, turn.as_quat(), place, strict=True):
            head, ns = self.header(stamp, parent)
            moved = types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](*p), rotation=types["geometry_msgs/msg/Quaternion"](*q)
            )
            stamped = types["geometry_msgs/msg/TransformStamped"](header=head, child_frame_id=child, transform=moved)
            self.add(topic, "tf2_msgs/msg/TFMessage", ns, transforms=[stamped])
        return self

    def static(self, parent: str, child: str, turn: Rotation, place: Array) -> Bag:
        always = Rotation.from_quat(turn.as_quat()[None])
        return self.transforms("/tf_static", parent, child, np.zeros(1), always, place[None])

    def tree(self, *left_out: str, end: str = "ft_sensor") -> Bag:
        """base - link - flange - tool0 - the sensor, without the transforms to the children left out."""
        last = float(self.frame["time"].iloc[-1])
        for child, rate in RATES.items():
            t = np.arange(0.0007, last, 1 / rate)
            turn, place = link(t)
            if child == "flange":
                motion = poses_at(self.frame, t)
                sensor = Rotation.from_quat(motion[QUATERNION].to_numpy(copy=True))
                flange = sensor * MOUNT.inv() * FLANGE.inv()
                at = motion[POSITION].to_numpy() - (flange * FLANGE).apply(LEVER) - flange.apply(STILL)
                turn, place = turn.inv() * flange, turn.inv().apply(at - place)
            if child not in left_out:
                self.transforms("/tf", "base" if child == "link" else "link", child, t, turn, place)
        for parent, child, turn, place in (("flange", "tool0", FLANGE, STILL), ("tool0", end, MOUNT, LEVER)):
            if child not in left_out:
                self.static(parent, child, turn, place)
        return self

    def written(self, path: Path, storage: str = "mcap") -> Path:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as RosBag

        with RosBag(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            write_messages(writer, self.store, sorted(self.messages, key=lambda message: message[2]))
        return path


def readings(frame: pd.DataFrame) -> Array:
    return frame[CHANNELS].to_numpy(copy=True)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_pose_of_the_raw_wrench_is_composed_through_tf(storage: str, tmp_path: Path) -> None:
    """Transforms at other rates and stamps than each other's and the wrench's, and two turned mountings at rest."""
    frame = original().iloc[:700]
    bag = Bag(frame).wrench("/ft/filtered", "tool0", 0.5 * readings(frame))
    bag.wrench("/ft/compensated", "base", readings(frame) - WEIGHTLESS).wrench("/ft/raw", "ft_sensor", readings(frame))
    found = import_recording([bag.tree().written(tmp_path / "bag", storage)])
    require_motion(found, frame)
    report = " ".join(str(found.report).split())
    chosen = "of 3 topics with a wrench: /ft/filtered is filtered, /ft/compensated is compensated by the driver"
    assert chosen in report
    assert "pose composed along base - link - flange - tool0 - ft_sensor" in report


def require_motion(found: ImportedRecording, frame: pd.DataFrame) -> None:
    """The run's readings, exactly, and its motion: angles and places are recorded in steps of 1e-5 rad and 1e-6 m."""
    first = int(np.argmin(np.abs(frame["fx"].to_numpy() - found.columns["fx"][0])))
    rows = frame.iloc[first : first + found.report.samples]
    np.testing.assert_allclose(found.columns["fx"], rows["fx"], rtol=0, atol=1e-12)
    turned = Rotation.from_quat(np.stack([found.columns[column] for column in QUATERNION], axis=1))
    apart = turned * Rotation.from_quat(rows[QUATERNION].to_numpy(copy=True)).inv()
    assert apart.magnitude().max() < 3e-5
    for column in POSITION:
        np.testing.assert_allclose(found.columns[column], rows[column], rtol=0, atol=5e-6)


@pytest.mark.parametrize(
    ("left_out", "said_of_it"),
    [
        (
            ["tool0"],
            "tf leads from ft_sensor up to tool0, and what moves hangs on base: a transform between that and tool0",
        ),
        (["ft_sensor"], "tf has no frame ft_sensor, but base, tool0, link, flange"),
        (["link", "flange"], "nothing moves in tf, which ends at flange"),
    ],
)
def test_a_link_that_is_missing_in_tf_is_named(left_out: list[str], said_of_it: str, tmp_path: Path) -> None:
    frame = original().iloc[:100]
    path = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree(*left_out).written(tmp_path / "bag")
    with pytest.raises(InputError) as raised:
        import_recording([path])
    assert said_of_it in str(raised.value)
    assert "record the pose of ft_sensor" in str(raised.value)


def test_a_moving_part_that_is_not_connected_is_said(tmp_path: Path) -> None:
    """Without the first joint's transform the pose is one in the link, which moves."""
    frame = original().iloc[:200]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree("link")
    t = frame["time"].to_numpy()
    path = bag.transforms("/tf", "base", "shoulder", t, *link(t)).written(tmp_path / "bag")
    steps = said(import_recording([path]), StepKind.TAKEN)
    assert "in tf base and what moves on it is not connected with link, in which ft_sensor is given" in steps


def test_wrenches_of_one_rank_are_asked_for_and_chosen_by_a_map(tmp_path: Path) -> None:
    frame = original().iloc[:300]
    bag = Bag(frame).wrench("/left/ft", "other_hand", readings(frame) - WEIGHTLESS).tree()
    path = bag.wrench("/right/ft", "ft_sensor", readings(frame)).written(tmp_path / "bag")
    require_motion(import_recording([path]), frame)  # of the other one tf does not tell the pose
    both = Bag(frame).wrench("/left/ft", "tool0", readings(frame) - WEIGHTLESS).tree()
    path = both.wrench("/right/ft", "ft_sensor", readings(frame)).written(tmp_path / "both")
    with pytest.raises(InputError, match=r'that of /left/ft or /right/ft; state it in a map: wrench = "/left/ft"'):
        import_recording([path])
    chosen = ReadingOptions(stated=ColumnMap.of({"wrench": "/right/ft"}))
    require_motion(import_recording([path], chosen), frame)
    with pytest.raises(InputError, match="there is no topic, sheet or file '/ft' among /left/ft, /right/ft"):
        import_recording([path], ReadingOptions(stated=ColumnMap.of({"wrench": "/ft"})))


def test_poses_of_several_topics_are_asked_for(tmp_path: Path) -> None:
    """Unless tf tells that of the wrench's own frame."""
    frame = original().iloc[:100]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame))
    for topic, shift in (("/tcp_pose", 0.0), ("/flange_pose", 1.0)):
        point, quaternion = (bag.store.types[f"geometry_msgs/msg/{kind}"] for kind in ("Point", "Quaternion"))
        for row in frame.itertuples():
            head, ns = bag.header(float(str(row.time)), "base")
            place = point(float(str(row.px)) + shift, row.py, row.pz)
            pose = bag.store.types["geometry_msgs/msg/Pose"](
                position=place, orientation=quaternion(row.qx, row.qy, row.qz, row.qw)
            )
            bag.add(topic, "geometry_msgs/msg/PoseStamped", ns, header=head, pose=pose)
    path = bag.written(tmp_path / "bag")
    with pytest.raises(InputError, match=r'could be that of /tcp_pose or /flange_pose; .*quaternion = "/tcp_pose"'):
        import_recording([path])
    chosen = import_recording([path], ReadingOptions(stated=ColumnMap.of({"quaternion": "/tcp_pose"})))
    require_motion(chosen, frame)
    require_motion(import_recording([bag.tree().written(tmp_path / "with_tf")]), frame)


def test_nothing_is_interpolated_where_tf_stopped(tmp_path: Path) -> None:
    """The slower joint's transforms are lost for a second of 2.8: the longer piece remains, in its true pose."""
    frame = original().iloc[:700]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree()
    start = EPOCH * 10**9 + 2 * 10**8
    bag.messages = [
        (topic, kind, stamp, message)
        for topic, kind, stamp, message in bag.messages
        if not (topic == "/tf" and message.transforms[0].child_frame_id == "flange" and 0 < stamp - start < 10**9)
    ]
    found = import_recording([bag.written(tmp_path / "bag")])
    require_motion(found, frame)
    assert 350 < found.report.samples < 420  # from 1.2 to 2.8 s at 250 Hz


@pytest.mark.parametrize(
    ("frame_id", "said_of_it"),
    [
        ("ft_sensor", "tf gives ft_sensor two parents, table and tool0"),
        ("", "the header of the wrench names no frame that tf could lead to"),
    ],
)
def test_a_frame_without_one_pose_is_refused(frame_id: str, said_of_it: str, tmp_path: Path) -> None:
    frame = original().iloc[:100]
    bag = Bag(frame).wrench("/ft/raw", frame_id, readings(frame)).tree()
    path = bag.static("table", "ft_sensor", MOUNT, LEVER).written(tmp_path / "bag")
    with pytest.raises(InputError, match=said_of_it):
        import_recording([path])


@pytest.mark.parametrize(
    ("parent", "child", "said_of_it"),
    [
        ("ft_sensor", "base", "tf leads from ft_sensor round to ft_sensor again"),
        ("tool0", "ft_sensor", "tf gives ft_sensor two poses in tool0, where it is at rest"),
    ],
)
def test_a_tree_that_contradicts_itself_is_refused(parent: str, child: str, said_of_it: str, tmp_path: Path) -> None:
    frame = original().iloc[:100]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree()
    with pytest.raises(InputError, match=said_of_it):
        import_recording([bag.static(parent, child, FLANGE, LEVER).written(tmp_path / "bag")])


def test_transforms_without_a_pose_are_ignored(tmp_path: Path) -> None:
    frame = original().iloc[:200]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree()
    types = bag.store.types
    for child, place, w in (("tool0", 0.0, 0.0), ("flange", np.nan, 1.0)):
        head, ns = bag.header(0.4, "flange" if child == "tool0" else "link")
        moved = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](place, 0.0, 0.0),
            rotation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, w),
        )
        stamped = types["geometry_msgs/msg/TransformStamped"](header=head, child_frame_id=child, transform=moved)
        bag.add("/tf", "tf2_msgs/msg/TFMessage", ns, transforms=[stamped])
    found = import_recording([bag.written(tmp_path / "bag")])
    require_motion(found, frame)
    assert "transforms without numbers or with a quaternion of zeros, ignored (2)" in " ".join(
        str(found.report).split()
    )


def test_a_wrench_along_the_bases_axes_is_not_given_the_bases_pose(tmp_path: Path) -> None:
    frame = original().iloc[:100]
    path = Bag(frame).wrench("/external_wrench", "base", readings(frame)).tree().written(tmp_path / "bag")
    with pytest.raises(InputError, match="its frame base does not move in tf: its axes are the base's"):
        import_recording([path])


def test_signals_of_another_topic_are_named_by_a_map(tmp_path: Path) -> None:
    """An inertial unit's, sampled at other stamps; without a map its topic is said to be unused."""
    frame = original().iloc[:300]
    bag = Bag(frame).wrench("/ft/raw", "ft_sensor", readings(frame)).tree()
    types = bag.store.types
    vector, nine = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    for t in np.arange(0.0003, 1.2, 1 / 400):
        head, ns = bag.header(t, "imu")
        bag.add(
            "/imu", "sensor_msgs/msg/Imu", ns, header=head,
            orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), orientation_covariance=nine,
            angular_velocity=vector(0.0, 0.0, 0.0), angular_velocity_covariance=nine,
            linear_acceleration=vector(np.sin(3 * t), 0.0, 9.8), linear_acceleration_covariance=nine,
        )  # fmt: skip
    path = bag.written(tmp_path / "bag")
    assert "not used: /imu" in said(import_recording([path]), StepKind.TAKEN)
    found = import_recording([path], ReadingOptions(stated=ColumnMap.of({"imu_ax": "linear_acceleration.x"})))
    require_motion(found, frame)
    first = int(np.argmin(np.abs(frame["fx"].to_numpy() - found.columns["fx"][0])))
    t = frame["time"].to_numpy()[first : first + found.report.samples]
    np.testing.assert_allclose(found.columns["imu_ax"], np.sin(3 * t), rtol=0, atol=1e-5)  # linear: (3/400)²/8
