"""Log files: one simulated recording as each robot, driver or recorder writes it, by the format's own library."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from estimation.reading.log_reader import Array
from truewrench.simulated_rig import SpatialRig, ViscousDrag, simulate

DRAG = ViscousDrag(c=1.0, d=0.12)
EPOCH = 1_760_000_000
CHANNELS = ["fx", "fy", "fz", "tx", "ty", "tz"]
QUATERNION = ["qx", "qy", "qz", "qw"]
POSITION = ["px", "py", "pz"]
Frame = pd.DataFrame
Writer = Callable[[Frame, Path], "list[Path]"]


@cache
def original(samples: int = 2500, period: float = 10.0) -> Frame:
    """One run of the six-axis rig with a hidden drag."""
    rig = SpatialRig()
    motion = rig.random_motion(seed=3, period=period)
    frame = simulate(rig, motion, hidden=[DRAG], repeats=1, samples_per_period=samples, seed=5)
    return frame.drop(columns="repeat")


def rotations(frame: Frame) -> Rotation:
    """Sensor in the world."""
    return Rotation.from_quat(frame[QUATERNION].to_numpy(copy=True))


def matrices(frame: Frame) -> Array:
    """Poses as homogeneous matrices (n, 4, 4)."""
    poses = np.tile(np.eye(4), (len(frame), 1, 1))
    poses[:, :3, :3] = rotations(frame).as_matrix()
    poses[:, :3, 3] = frame[POSITION]
    return poses


def in_base_axes(frame: Frame) -> Frame:
    """The wrench along the base's axes, about the same point."""
    turn, turned = rotations(frame), frame.copy()
    for names in (CHANNELS[:3], CHANNELS[3:]):
        turned[names] = turn.apply(frame[names].to_numpy(copy=True))
    return turned


# ------------------------------------------------------------------------------------------------ text


def _text(**options: Any) -> Writer:
    suffix = options.pop("suffix", ".csv")

    def write(frame: Frame, folder: Path) -> list[Path]:
        path = folder / f"run{suffix}"
        frame.to_csv(path, index=False, **options)
        return [path]

    return write


def bota(frame: Frame, folder: Path) -> list[Path]:
    """Names with units, comma and blank, a blank column, every third row doubled, a column of text."""
    rows = np.sort(np.concatenate([np.arange(len(frame)), np.arange(0, len(frame), 3)]))
    named = frame[["time", *CHANNELS, *QUATERNION, *POSITION]].rename(
        columns={c: c.capitalize() + "_N" for c in CHANNELS[:3]}
    )
    named = named.rename(columns={c: c.capitalize() + "_Nm" for c in CHANNELS[3:]} | {"time": "Time_s"})
    named.insert(3, " ", "")
    named["status"] = "ok"
    path = folder / "bota.csv"
    text = named.iloc[rows].to_csv(index=False).replace(",", ", ")
    path.write_text(text)
    return [path]


def ur_rtde(frame: Frame, folder: Path) -> list[Path]:
    """The RTDE client's record: spaces, rotation vectors, force along base axes, a duplicated column."""
    base = in_base_axes(frame)
    vectors = rotations(frame).as_rotvec()
    columns: dict[str, Any] = {"timestamp": 321.5 + frame["time"]}
    columns |= {f"actual_q_{j}": np.sin(frame["time"] + j) for j in range(6)}
    columns |= {f"actual_TCP_pose_{j}": frame[name] for j, name in enumerate(POSITION)}
    columns |= {f"actual_TCP_pose_{j + 3}": vectors[:, j] for j in range(3)}
    columns |= {f"actual_TCP_speed_{j}": np.cos(frame["time"] + j) for j in range(6)}
    columns |= {f"actual_TCP_force_{j}": base[name] for j, name in enumerate(CHANNELS)}
    path = folder / "robot_data.csv"
    text = Frame(columns).to_csv(sep=" ", index=False)
    path.write_text(text.replace("actual_q_1 ", "actual_q_0 ", 1))
    return [path]


def franka_csv(frame: Frame, folder: Path) -> list[Path]:
    """State log: 4 x 4 column by column, time in ms."""
    columns: dict[str, Any] = {"time": frame["time"] * 1e3}
    columns |= {f"O_T_EE[{i}]": matrices(frame).transpose(0, 2, 1).reshape(-1, 16)[:, i] for i in range(16)}
    columns |= {f"q[{j}]": np.sin(frame["time"] + j) for j in range(7)}
    base = in_base_axes(frame)
    columns |= {f"O_F_ext_hat_K[{i}]": base[name] for i, name in enumerate(CHANNELS)}
    path = folder / "franka.csv"
    Frame(columns).to_csv(path, index=False)
    return [path]


def franka_hdf5(frame: Frame, folder: Path) -> list[Path]:
    """The same as datasets (n, 16) and (n, 6)."""
    import h5py

    path = folder / "franka.h5"
    with h5py.File(path, "w") as file:
        file["state/time"] = frame["time"].to_numpy()
        file["state/O_T_EE"] = matrices(frame).transpose(0, 2, 1).reshape(-1, 16)
        file["state/K_F_ext_hat_K"] = frame[CHANNELS].to_numpy()
        file["state/O_F_ext_hat_K"] = in_base_axes(frame)[CHANNELS].to_numpy()
        file["state/name"] = "a run"
    return [path]


def rostopic_csv(frame: Frame, folder: Path) -> list[Path]:
    """`rostopic echo -p`: wrench and pose in a file each, ns since 1970, text."""
    stamps = EPOCH * 10**9 + np.round(frame["time"] * 1e9).astype(np.int64)
    paths = []
    for name, fields in (("wrench", wrench_fields("field.wrench")), ("pose", pose_fields("field.pose"))):
        head = {"%time": stamps + 3_000_000, "field.header.seq": np.arange(len(frame)), "field.header.stamp": stamps}
        table = Frame({**head, "field.header.frame_id": "tool0", **{f: frame[c] for f, c in fields.items()}})
        paths.append(folder / f"{name}.csv")
        table.to_csv(paths[-1], index=False)
    return paths


def ros2_echo_csv(frame: Frame, folder: Path) -> list[Path]:
    """`ros2 topic echo --csv` of a wrench, without header, beside a CSV of poses in seconds since 1970."""
    stamps = EPOCH * 10**9 + np.round(frame["time"] * 1e9).astype(np.int64)
    head = {"sec": stamps // 10**9, "nanosec": stamps % 10**9, "frame": "tool0"}
    wrench, pose = folder / "wrench.csv", folder / "pose.csv"
    Frame({**head, **{c: frame[c] for c in CHANNELS}}).to_csv(wrench, index=False, header=False)
    frame[["time", *POSITION, *QUATERNION]].assign(time=stamps * 1e-9).to_csv(pose, index=False)
    return [wrench, pose]


def plotjuggler(frame: Frame, folder: Path) -> list[Path]:
    """Two topics in one table: each row is a sample of one of them, the other's cells are empty."""
    wrench = Frame(
        {"__time": EPOCH + frame["time"], **{f: frame[c] for f, c in wrench_fields("/ft/wrench", "/").items()}}
    )
    pose = Frame(
        {"__time": EPOCH + frame["time"] + 1e-3, **{f: frame[c] for f, c in pose_fields("/arm/pose", "/").items()}}
    )
    pose.iloc[:, 1:] = poses_at(frame, frame["time"].to_numpy() + 1e-3)[[*POSITION, *QUATERNION]].to_numpy()
    path = folder / "plotjuggler.csv"
    pd.concat([wrench, pose]).sort_values("__time").to_csv(path, index=False)
    return [path]


def orocos(frame: Frame, folder: Path) -> list[Path]:
    """Reporter with port names, spaces."""
    columns = {"TimeStamp": frame["time"]}
    columns |= {f"read_tf.outport_pose.{i}": frame[c] for i, c in enumerate([*POSITION, *QUATERNION])}
    columns |= {f"jr3.sensor_0.{f}": frame[c] for f, c in wrench_fields("wrench_filter_0").items()}
    path = folder / "report.dat"
    Frame(columns).to_csv(path, sep=" ", index=False)
    return [path]


def headerless(frame: Frame, folder: Path) -> list[Path]:
    """`--preset xyz_quaternion_wrench`: numbers alone, comma and blank."""
    path = folder / "log.txt"
    text = frame[["time", *POSITION, *QUATERNION, *CHANNELS]].to_csv(index=False, header=False)
    path.write_text(text.replace(",", ", "))
    return [path]


def wrench_fields(prefix: str, separator: str = ".") -> dict[str, str]:
    """Fields of a Wrench message by their paths."""
    kinds = {"f": "force", "t": "torque"}
    return {separator.join((prefix, kinds[c[0]], c[1])): c for c in CHANNELS}


def pose_fields(prefix: str, separator: str = ".") -> dict[str, str]:
    """Fields of a Pose message by their paths."""
    fields = {separator.join((prefix, "position", c[1])): c for c in POSITION}
    return fields | {separator.join((prefix, "orientation", c[1])): c for c in QUATERNION}


def poses_at(frame: Frame, instants: Array, motion_seed: int = 3) -> Frame:
    """The noise-free motion of the same run at other instants: by the simulator, not by interpolation."""
    rig = SpatialRig()
    motion = rig.random_motion(seed=motion_seed, period=10.0)
    return Frame(rig.motion_columns(rig.quantised(motion.evaluate(instants)[0])))


def two_clocks(frame: Frame, folder: Path, offset: float = 0.037, seed: int = 1, motion_seed: int = 3) -> list[Path]:
    """Wrench and pose in a file each: the wrench's stamps are late and jitter, 3 samples are lost, rates differ."""
    rng = np.random.default_rng(seed)
    lost = rng.choice(np.arange(100, len(frame) - 100), 3, replace=False)
    wrench = frame[["time", *CHANNELS]].drop(index=lost.tolist())
    wrench["time"] += offset + rng.normal(0, 2e-4, len(wrench))
    instants = np.arange(0.0013, frame["time"].iloc[-1], 1 / 200)
    pose = poses_at(frame, instants, motion_seed).assign(time=instants)
    paths = [folder / "force.csv", folder / "robot.csv"]
    wrench.to_csv(paths[0], index=False)
    pose.to_csv(paths[1], index=False, sep=";")
    return paths


# --------------------------------------------------------------------------------------------- binary


def excel(frame: Frame, folder: Path) -> list[Path]:
    """A workbook with a title above the header, and blank columns."""
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("run 1")
    names = ["time", *CHANNELS, *QUATERNION, *POSITION]
    sheet.append(["measured on the bench"])
    sheet.append(["Time (s)", None, *names[1:]])
    for row in frame[names].itertuples(index=False):
        sheet.append([row[0], None, *row[1:]])
    path = folder / "run.xlsx"
    book.save(path)
    return [path]


def matlab(frame: Frame, folder: Path) -> list[Path]:
    """A struct with the pose as 4 x 4 x N and the wrench as 6 x N."""
    from scipy.io import savemat

    pose = matrices(frame).transpose(1, 2, 0)
    path = folder / "run.mat"
    savemat(
        path,
        {"data": {"t": frame["time"].to_numpy(), "pose": pose, "wrench": frame[CHANNELS].to_numpy().T, "who": "me"}},
    )
    return [path]


def matlab_73(frame: Frame, folder: Path) -> list[Path]:
    """What MATLAB writes with -v7.3: HDF5 with a header of its own and transposed arrays."""
    import h5py

    path = folder / "run73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        arrays = {"t": frame["time"].to_numpy()[None], "wrench": frame[CHANNELS].to_numpy().T}
        arrays["pose"] = matrices(frame).transpose(0, 2, 1)
        for name, array in arrays.items():
            file[f"data/{name}"] = array.T if name == "wrench" else array
            file[f"data/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return [path]


def numpy_archive(frame: Frame, folder: Path) -> list[Path]:
    """An .npz of arrays."""
    path = folder / "run.npz"
    columns = {"time": "time", "quat": QUATERNION, "pos": POSITION, "wrench": CHANNELS}
    arrays: dict[str, Any] = {name: frame[own].to_numpy() for name, own in columns.items()}
    np.savez(path, **arrays)
    return [path]


def parquet(frame: Frame, folder: Path) -> list[Path]:
    """Other names, a column of text, time as timestamps."""
    path = folder / "run.parquet"
    time = pd.to_datetime(EPOCH * 10**9 + np.round(frame["time"] * 1e9).astype(np.int64))
    names = wrench_fields("wrench") | pose_fields("pose")
    Frame({"stamp": time, "state": "moving", **{f: frame[c] for f, c in names.items()}}).to_parquet(path)
    return [path]


# ------------------------------------------------------------------------------------------- ROS bags


def ros_types() -> Any:
    """The message types of a ROS 2 distribution, which ROS 1 has alike but for its header."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return get_typestore(Stores.ROS2_HUMBLE), store


def ros_messages(types: Any, frame: Frame, *, ros1: bool = False, tf: bool = False) -> Any:
    """(topic, type, receive stamp in ns, message): wrench, and the pose as a topic or by tf of three links."""

    def header(stamp: Any, name: str) -> Any:
        ns = EPOCH * 10**9 + round(stamp * 1e9)
        time = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        more = {"seq": 0} if ros1 else {}
        return types["std_msgs/msg/Header"](stamp=time, frame_id=name, **more), ns

    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]

    def stamped(stamp: Any, parent: str, child: str, place: Any, turn: Any) -> Any:
        moved = types["geometry_msgs/msg/Transform"](
            translation=vector(*map(float, place)), rotation=quaternion(*map(float, turn))
        )
        return types["geometry_msgs/msg/TransformStamped"](
            header=header(stamp, parent)[0], child_frame_id=child, transform=moved
        )

    mount = Rotation.from_euler("XYZ", [0.3, -0.2, 0.9])
    lever = np.array([0.02, -0.01, 0.1])
    if tf:
        link = stamped(0.0, "flange", "tool0", lever, mount.as_quat())
        yield (
            "/tf_static",
            "tf2_msgs/msg/TFMessage",
            header(0.0, "")[1],
            types["tf2_msgs/msg/TFMessage"](transforms=[link]),
        )
    for row in frame.itertuples():
        head, ns = header(row.time, "tool0")
        wrench = types["geometry_msgs/msg/Wrench"](
            force=vector(row.fx, row.fy, row.fz), torque=vector(row.tx, row.ty, row.tz)
        )
        yield (
            "/ft/wrench",
            "geometry_msgs/msg/WrenchStamped",
            ns + 4_000_000,
            types["geometry_msgs/msg/WrenchStamped"](header=head, wrench=wrench),
        )
        head, ns = header(row.time, "base")
        if tf:
            turn = Rotation.from_quat([row.qx, row.qy, row.qz, row.qw]) * mount.inv()
            place = np.array([row.px, row.py, row.pz]) - turn.apply(lever)
            message = types["tf2_msgs/msg/TFMessage"](
                transforms=[stamped(row.time, "base", "flange", place, turn.as_quat())]
            )
            yield "/tf", "tf2_msgs/msg/TFMessage", ns, message
            continue
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](row.px, row.py, row.pz),
            orientation=quaternion(row.qx, row.qy, row.qz, row.qw),
        )
        yield (
            "/arm/pose",
            "geometry_msgs/msg/PoseStamped",
            ns + 9_000_000,
            types["geometry_msgs/msg/PoseStamped"](header=head, pose=pose),
        )


def ros1_bag(frame: Frame, folder: Path) -> list[Path]:
    """A ROS 1 bag with the pose by tf."""
    from rosbags.rosbag1 import Writer

    store = ros_types()[1]
    path = folder / "run.bag"
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp, message in ros_messages(store.types, frame, ros1=True, tf=True):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], stamp, store.serialize_ros1(message, kind))
    return [path]


def ros2_bag(storage: str) -> Writer:
    """A ROS 2 bag of a storage, "sqlite3" or "mcap", with the pose as a topic."""

    def write(frame: Frame, folder: Path) -> list[Path]:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Bag

        store = ros_types()[0]
        path = folder / f"bag_{storage}"
        with Bag(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            write_messages(writer, store, ros_messages(store.types, frame))
        return [path]

    return write


def euler(names: str, order: Any) -> Writer:
    """A CSV with millimetres and Euler angles in degrees, as a controller calls them, about these axes."""

    def write(frame: Frame, folder: Path) -> list[Path]:
        angles = rotations(frame).as_euler(order, degrees=True)
        pose = np.hstack([1000 * frame[POSITION].to_numpy(), angles])
        columns = dict(zip(names.split(), pose.T, strict=True))
        frame.drop(columns=POSITION + QUATERNION).assign(**columns).to_csv(folder / "pose.csv", index=False)
        return [folder / "pose.csv"]

    return write


def lerobot(version: str) -> Writer:
    """The second of three episodes of a LeRobot data set: pose and gripper in one list, wrench, commanded pose."""

    def write(frame: Frame, folder: Path) -> list[Path]:
        return [lerobot_data_set(frame, folder / "data_set", version, episodes=3) / "episode_000001"]

    return write


STATE = ["x", "y", "z", "qx", "qy", "qz", "qw", "gripper.pos"]


def lerobot_data_set(frame: Frame, folder: Path, version: str, *, episodes: int = 1, named: bool = True) -> Path:
    """A LeRobot data set of equal episodes, but that the others' force is none; its folder."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def feature(names: object, size: int, kind: str = "float64") -> dict[str, object]:
        return {"dtype": kind, "shape": [size], "names": names if named else None}

    vectors = {
        "observation.state": feature(STATE, 8),
        "observation.wrench": feature(
            {"axes": ["force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z"]}, 6
        ),
        "action": feature({"motors": STATE}, 8),
    }
    numbers = {"timestamp": feature(None, 1, "float32")}
    numbers |= {n: feature(None, 1, "int64") for n in ("frame_index", "episode_index", "index", "task_index")}
    second = version.startswith("v2")
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    (folder / "meta").mkdir()
    data_path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    described = {
        "codebase_version": version, "robot_type": "arm", "fps": round(1 / float(np.mean(np.diff(frame["time"])))),
        "total_episodes": episodes, "total_frames": episodes * len(frame), "total_tasks": 1, "chunks_size": 1000,
        "data_path": data_path if second else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None, "splits": {"train": f"0:{episodes}"}, "features": vectors | numbers,
    }  # fmt: skip
    (folder / "meta" / "info.json").write_text(json.dumps(described), encoding="utf-8")
    tables, stats = [], []
    for episode in range(episodes):
        state = np.column_stack([frame[POSITION + QUATERNION], np.linspace(0, 1, len(frame))])
        wrench = frame[CHANNELS].to_numpy() * (episode == episodes // 2)
        columns = {
            "observation.state": pa.array(list(state), pa.list_(pa.float64(), 8)),
            "action": pa.array(list(np.roll(state, -1, axis=0)), pa.list_(pa.float64(), 8)),
            "observation.wrench": pa.array(list(wrench), pa.list_(pa.float64(), 6)),
            "timestamp": pa.array((frame["time"] - frame["time"].iloc[0]).astype(np.float32)),
            "frame_index": np.arange(len(frame)),
            "episode_index": np.full(len(frame), episode),
            "index": np.arange(len(frame)) + episode * len(frame),
            "task_index": np.zeros(len(frame), dtype=int),
        }
        tables.append(pa.table(columns))
        stats.append({"observation.wrench": lerobot_statistics(wrench)})
    if second:
        for episode, table in enumerate(tables):
            pq.write_table(table, chunk / f"episode_{episode:06d}.parquet")
        lines = [json.dumps({"episode_index": episode, "stats": own}) for episode, own in enumerate(stats)]
        (folder / "meta" / "episodes_stats.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
        task = json.dumps({"task_index": 0, "task": "swing"})
        (folder / "meta" / "tasks.jsonl").write_text(task + "\n", encoding="utf-8")
        lengths = [{"episode_index": i, "tasks": ["swing"], "length": len(frame)} for i in range(episodes)]
        text = "".join(json.dumps(line) + "\n" for line in lengths)
        (folder / "meta" / "episodes.jsonl").write_text(text, encoding="utf-8")
        return folder
    pq.write_table(pa.concat_tables(tables), chunk / "file-000.parquet")
    first = [len(frame) * episode for episode in range(episodes)]
    of_episodes: dict[str, Any] = {
        "episode_index": list(range(episodes)), "tasks": [["swing"]] * episodes, "length": [len(frame)] * episodes,
        "dataset_from_index": first, "dataset_to_index": [start + len(frame) for start in first],
        **{f"{kind}/{name}_index": [0] * episodes for kind in ("data", "meta/episodes") for name in ("chunk", "file")},
    }  # fmt: skip
    for name in stats[0]["observation.wrench"]:
        of_episodes[f"stats/observation.wrench/{name}"] = [own["observation.wrench"][name] for own in stats]
    (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    pq.write_table(pa.table(of_episodes), folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=["swing"]).to_parquet(folder / "meta" / "tasks.parquet")
    wrenches = np.concatenate([table["observation.wrench"].to_pylist() for table in tables])
    whole = {"observation.wrench": lerobot_statistics(wrenches)}
    (folder / "meta" / "stats.json").write_text(json.dumps(whole), encoding="utf-8")
    return folder


def lerobot_statistics(values: Array) -> dict[str, list[float]]:
    """Of a feature's rows (n, k), as a data set of version 2.1 or 3.0 states them."""
    rows = {name: getattr(values, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
    return rows | {"count": [len(values)]}


def write_messages(writer: Any, store: Any, messages: Any) -> None:
    """Write (topic, type, receive stamp, message) to an open ROS 2 bag."""
    connections: dict[str, Any] = {}
    for topic, kind, stamp, message in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))


FORMATS: Mapping[str, Writer] = {
    "semicolons": _text(sep=";"),
    "tabs and decimal commas": _text(sep="\t", decimal=","),
    "semicolons and decimal commas": _text(sep=";", decimal=",", float_format="%.12f"),
    "gzip": _text(suffix=".csv.gz"),
    "bzip2": _text(suffix=".txt.bz2", sep=" "),
    "xz": _text(suffix=".csv.xz"),
    "zip": _text(suffix=".csv.zip", compression="zip"),
    "latin-1 and CR LF": _text(suffix=".log", encoding="utf-16", lineterminator="\r\n"),
    "bota": bota,
    "ur_rtde": ur_rtde,
    "franka": franka_csv,
    "franka hdf5": franka_hdf5,
    "rostopic echo -p": rostopic_csv,
    "ros2 topic echo --csv": ros2_echo_csv,
    "orocos": orocos,
    "excel": excel,
    "matlab": matlab,
    "matlab 7.3": matlab_73,
    "numpy": numpy_archive,
    "parquet": parquet,
    "ros 1 bag": ros1_bag,
    "ros 2 bag sqlite3": ros2_bag("sqlite3"),
    "ros 2 bag mcap": ros2_bag("mcap"),
    "kuka": euler("POS_ACT.X POS_ACT.Y POS_ACT.Z POS_ACT.A POS_ACT.B POS_ACT.C", "ZYX"),
    "fanuc": euler("X Y Z W P R", "xyz"),
    "xarm": euler("x y z roll pitch yaw", "xyz"),
    "lerobot 2": lerobot("v2.1"),
    "lerobot 3": lerobot("v3.0"),
}
"""Formats whose import is the original recording again, within the digits that they hold."""


def w_first(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns as xyzw is taken for when the file has wxyz."""
    names = dict(zip(QUATERNION, ("qw", "qx", "qy", "qz"), strict=True))
    return {**columns, **{new: columns[old] for new, old in names.items()}}
