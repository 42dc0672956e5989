"""Reader of ROS 1 and ROS 2 bags (sqlite3, MCAP): wrench, joint states, poses, tf, by their header stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.reading.log_reader import (
    NO_WRENCH,
    ROS_TOPIC,
    TF_CHAIN,
    Array,
    LogReader,
    LogTable,
    SourceFile,
    require_size,
)
from estimation.reading.sample_mending import interpolated_position, interpolated_quaternion

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

LATE = 1e-3
"""Seconds by which messages are received after their stamps, from which it is said: a wrench is delayed by as much."""
NUMBERS_OF_MESSAGE = 10
"""Of any type that is read, with its stamps."""


@dataclass(frozen=True)
class Transform:
    """Pose of `child` in `parent` at a stamp (s): x, y, z (m), then the quaternion x, y, z, w; `fixed` for ever."""

    parent: str
    child: str
    stamp: float
    values: tuple[float, ...]
    fixed: bool


LONGEST_GAP = 10
"""Usual steps of a transform between two of its stamps, beyond which nothing is interpolated: it stopped meanwhile."""
FEWEST_STAMPS = 3
"""Of a transform that moves; fewer are a mounting that was published with the moving ones."""
SAME_POSE = 1e-6
"""m, and of a quaternion's elements, which single precision rounds by less: further apart, a mounting was changed."""
SHOWN_FRAMES = 6
"""Frames that a message names."""


class TransformTree:
    """Transforms by child frame, each with its series of poses; and their stamps, s, none twice."""

    def __init__(self, transforms: Sequence[Transform]) -> None:
        self.series: dict[str, list[Transform]] = {}
        for transform in transforms:
            self.series.setdefault(transform.child, []).append(transform)
        self.stamps = {child: np.unique([t.stamp for t in series]) for child, series in self.series.items()}

    def chain(self, frame: str) -> list[str]:
        """Child frames from a frame up to the root; none when tf does not know the frame."""
        frames: list[str] = []
        while frame in self.series and frame not in frames:
            frames.append(frame)
            frame = self.series[frame][0].parent
        return frames

    def root(self, frame: str) -> str:
        """The frame at the top of a frame's chain; itself where nothing is above it."""
        chain = self.chain(frame)
        return self.series[chain[-1]][0].parent if chain else frame

    def is_moving(self, child: str) -> bool:
        """Whether a frame's transform was published again and again."""
        return not self.series[child][0].fixed and len(self.stamps[child]) >= FEWEST_STAMPS

    def _changes(self, child: str) -> bool:
        """Whether a frame's transforms differ; a quaternion and its negative do not."""
        values = np.array([transform.values for transform in self.series[child]])
        values[:, 3:] *= np.sign(values[:, 3:] @ values[0, 3:])[:, None]
        return bool(np.ptp(values, axis=0).max() > SAME_POSE)

    def pose_columns(self, frame: str) -> dict[str, Array]:
        """Pose of the frame in the root at the stamps of its fastest transform; none where `missing` says why."""
        from scipy.spatial.transform import Rotation  # slow to import

        if self.missing(frame):
            return {}
        chain, stamps = self.chain(frame), self._common_stamps(frame)
        place, turn = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
        for link in chain:
            offset, rotation = self._at(link, stamps)
            place, turn = Rotation.from_quat(rotation).apply(place) + offset, Rotation.from_quat(rotation) * turn
        names = [f"pose.position.{a}" for a in "xyz"] + [f"pose.orientation.{a}" for a in "xyzw"]
        return {"stamp": stamps, **dict(zip(names, np.hstack([place, turn.as_quat()]).T, strict=True))}

    def missing(self, frame: str) -> str:
        """Why tf does not tell the pose of a wrench's frame; empty where it does."""
        if not frame:
            return "the header of the wrench names no frame that tf could lead to"
        moving = [child for child in self.series if self.is_moving(child)]
        chain, root, roots = self.chain(frame), self.root(frame), {self.root(child) for child in moving}
        if root in chain:
            return f"tf leads from {frame} round to {root} again"
        twice = [child for child in chain if len({t.parent for t in self.series[child]}) > 1]
        if twice:
            parents = " and ".join(sorted({transform.parent for transform in self.series[twice[0]]}))
            return f"tf gives {twice[0]} two parents, {parents}"
        changed = [child for child in chain if not self.is_moving(child) and self._changes(child)]
        if changed:
            return f"tf gives {changed[0]} two poses in {self.series[changed[0]][0].parent}, where it is at rest"
        if any(child in moving for child in chain):
            alike = len(self._common_stamps(frame)) >= FEWEST_STAMPS
            return "" if alike else f"the transforms from {root} to {frame} have no time in common"
        if frame in roots:
            axes = 'state wrench_axes = "base" in a map, beside a pose of the sensor'
            return f"its frame {frame} does not move in tf: its axes are the base's ({axes})"
        if not moving:
            return f"nothing moves in tf, which ends at {root}"
        known = chain or any(t.parent == frame for series in self.series.values() for t in series)
        if not known:
            frames = [*dict.fromkeys([*sorted(roots), *self.series])]
            more = f" and {len(frames) - SHOWN_FRAMES} more" if len(frames) > SHOWN_FRAMES else ""
            return f"tf has no frame {frame}, but {', '.join(frames[:SHOWN_FRAMES])}{more}"
        leads = f"leads from {frame} up to {root}" if chain else f"has nothing above {frame}"
        hangs = f"what moves hangs on {' and '.join(sorted(roots))}"
        return f"tf {leads}, and {hangs}: a transform between that and {root} is missing (often of /tf_static)"

    def apart(self, frame: str) -> str:
        """What moves in tf and is not connected with a frame, as text; empty where all that moves is."""
        roots = {self.root(child) for child in self.series if self.is_moving(child)} - {self.root(frame)}
        if not roots:
            return ""
        moves, root = f"{' and '.join(sorted(roots))} and what moves on it", self.root(frame)
        return f"in tf {moves} is not connected with {root}, in which {frame} is given: right only if {root} is at rest"

    def _common_stamps(self, frame: str) -> Array:
        """Stamps (n,) of the fastest moving transform of a frame's chain that are in a piece of every moving one."""
        moving = [link for link in self.chain(frame) if self.is_moving(link)]
        stamps = self.stamps[max(moving, key=lambda link: len(self.series[link]))]
        for link in moving:
            pieces = [(stamps >= piece[0]) & (stamps <= piece[-1]) for piece in self._pieces(link)]
            stamps = stamps[np.any(pieces, axis=0)]
        return stamps

    def _pieces(self, link: str) -> list[Array]:
        """Stamps of a transform, between its gaps."""
        stamps = self.stamps[link]
        steps = np.diff(stamps)
        return np.split(stamps, np.flatnonzero(steps > LONGEST_GAP * np.median(steps)) + 1)

    def _at(self, link: str, stamps: Array) -> tuple[Array, Array]:
        series = self.series[link]
        values = np.array([transform.values for transform in series])
        if not self.is_moving(link):
            return np.tile(values[-1, :3], (len(stamps), 1)), np.tile(values[-1, 3:], (len(stamps), 1))
        instants, first = np.unique([transform.stamp for transform in series], return_index=True)
        values = values[first]
        if np.array_equal(instants, stamps):
            return values[:, :3], values[:, 3:]
        place, turn = np.zeros((len(stamps), 3)), np.zeros((len(stamps), 4))
        for piece in self._pieces(link):
            known, asked = np.isin(instants, piece), (stamps >= piece[0]) & (stamps <= piece[-1])
            place[asked] = interpolated_position(piece, values[known, :3], stamps[asked])
            turn[asked] = interpolated_quaternion(piece, values[known, 3:], stamps[asked])
        return place, turn


ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC = b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"


class RosBag(LogReader):
    """ROS bag; each topic is a table, of joint states each publisher."""

    title = "ROS bag"
    repair = "repair it (`mcap recover`, `ros2 bag reindex`, `rosbag reindex`), or give a bag that is whole"

    def recognises(self, source: SourceFile) -> bool:
        """By the magic strings of the three storages, or a folder with a metadata.yaml."""
        if source.path.is_dir():
            return (source.path / "metadata.yaml").exists()
        return source.head.startswith((ROS1_MAGIC, MCAP_MAGIC)) or (
            source.head.startswith(SQLITE_MAGIC) and source.suffix == ".db3"
        )

    def tables(self, source: SourceFile) -> list[LogTable]:
        """The topics with known message types."""
        if source.head.startswith(MCAP_MAGIC) and (profile := _mcap_profile(source.head)) != "ros2":
            what = f"an MCAP file with messages of {profile or 'no profile'}, and not of ROS 2"
            raise source.error(what, "export it as a ROS 2 bag, or as CSV, from the program that wrote it")
        topics = _Topics(source.name)
        with source.on_disk() as path:
            for topic, kind, received, message in messages(path):
                EXTRACTORS[kind](topics, topic, message, received * 1e-9)
                require_size(topics.messages * NUMBERS_OF_MESSAGE, str(source.path))
            tables = topics.tables()
            unread = unread_topics(path) if len(tables) < 2 or not topics.frames else ()
        if not tables and unread:
            what = f"{NO_WRENCH}; its topics are {', '.join(unread)}"
            raise source.error(what, "record the topics of wrench and pose, or joint states")
        return [replace(table, unread=unread) for table in tables]


def _mcap_profile(head: bytes) -> str:
    """What the header of an MCAP file, its first record, says of its messages; "ros2" where it is cut off."""
    start = len(MCAP_MAGIC) + 9  # behind the record's kind and length
    end = start + 4 + int.from_bytes(head[start : start + 4], "little")
    return head[start + 4 : end].decode("utf-8", "replace") if len(head) > end else "ros2"


def unread_topics(path: Path) -> tuple[str, ...]:
    """The topics of a bag whose message type is not read, with their types."""
    with _opened(path) as reader:
        others = {c.topic: c.msgtype.replace("/msg/", "/") for c in reader.connections if c.msgtype not in EXTRACTORS}
    return tuple(f"{topic} ({kind})" for topic, kind in others.items())


def messages(path: Path) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, message type, receive stamp (ns) and message of every message of a known type."""
    with _opened(path) as reader:
        connections = [c for c in reader.connections if c.msgtype in EXTRACTORS]
        if not connections:
            return
        for connection, received, raw in reader.messages(connections):
            yield connection.topic, connection.msgtype, received, reader.deserialize(raw, connection.msgtype)


def _opened(path: Path) -> AnyReader:
    """A reader of a bag, of any version."""
    from rosbags import highlevel, typesys  # slow to import

    return highlevel.AnyReader([path], default_typestore=typesys.get_typestore(typesys.Stores.ROS2_HUMBLE))


class _Topics:
    """What was read so far: rows by table, transforms."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.rows: dict[tuple[str, tuple[str, ...]], list[tuple[float, ...]]] = {}
        self.frames: dict[str, str] = {}
        self.lateness: dict[str, list[float]] = {}
        self.transforms: list[Transform] = []
        self.no_poses: list[str] = []
        self.messages = 0

    def add(self, topic: str, header: Any, received: float, values: Mapping[str, float]) -> float:
        """Add a message's values under its header stamp, or its receive stamp where that is empty."""
        stamp = received if header is None else header.stamp.sec + header.stamp.nanosec * 1e-9
        if stamp <= 0:
            stamp = received
        elif header is not None:
            self.lateness.setdefault(topic, []).append(received - stamp)
        self.rows.setdefault((topic, tuple(values)), []).append((stamp, *values.values()))
        self.messages += 1
        return stamp

    def tables(self) -> list[LogTable]:
        """A table for each topic and set of columns, and one for the pose of each frame of a wrench by tf."""
        tree = TransformTree(self.transforms)
        tables = [self._table(topic, names, rows, tree) for (topic, names), rows in self.rows.items()]
        chains = [self._chain(frame, tree) for frame in dict.fromkeys(self.frames.values()) if frame]
        return [*tables, *(table for table in chains if table.columns)]

    def _chain(self, frame: str, tree: TransformTree) -> LogTable:
        """The pose of a frame by tf; without columns where tf does not tell it."""
        columns = tree.pose_columns(frame)
        notes = []
        if columns:
            path = " - ".join([tree.root(frame), *reversed(tree.chain(frame))])
            notes = [(f"pose composed along {path}", len(columns["stamp"]), False)]
            notes += [(apart, 1, False)] if (apart := tree.apart(frame)) else []
            ignored = sum(child in tree.chain(frame) for child in self.no_poses)
            notes += [("transforms without numbers or with a quaternion of zeros, ignored", ignored, True)] * bool(
                ignored
            )
        name = f"{self.source}:/tf ({frame})"
        return LogTable(name=name, kind=TF_CHAIN, columns=columns, wrench_frame=frame, notes=tuple(notes))

    def _table(
        self, topic: str, names: tuple[str, ...], rows: list[tuple[float, ...]], tree: TransformTree
    ) -> LogTable:
        values = np.array(rows, dtype=np.float64).T
        columns: dict[str, Array] = dict(zip(("stamp", *names), values, strict=True))
        late = np.array(self.lateness.get(topic, [0.0]))
        notes = []
        if np.median(np.abs(late)) > LATE:
            what = f"header stamps used; received {np.median(late) * 1e3:.3g} ms later in the median,"
            what += f" {np.max(late) * 1e3:.3g} ms at most"
            notes.append((what, len(late), False))
        name = f"{self.source}:{topic}" + (f" ({names[0]}..)" if names and names[0].startswith("joint:") else "")
        frame = self.frames.get(topic)
        return LogTable(
            name=name, kind=ROS_TOPIC, columns=columns, wrench_frame=frame, notes=tuple(notes),
            without_pose="" if frame is None or not tree.series else tree.missing(frame),
        )  # fmt: skip


# ------------------------------------------------------------------------------------------- messages


def _vector(prefix: str, vector: Any, names: str = "xyz") -> dict[str, float]:
    return {f"{prefix}.{name}": float(getattr(vector, name)) for name in names}


def _wrench(topics: _Topics, topic: str, message: Any, received: float) -> None:
    header = getattr(message, "header", None)
    wrench = message.wrench if header is not None else message
    topics.add(topic, header, received, _vector("wrench.force", wrench.force) | _vector("wrench.torque", wrench.torque))
    topics.frames[topic] = "" if header is None else header.frame_id.strip("/")


def _pose_values(position: Any, orientation: Any) -> dict[str, float]:
    return _vector("pose.position", position) | _vector("pose.orientation", orientation, "xyzw")


def _pose(topics: _Topics, topic: str, message: Any, received: float) -> None:
    header = getattr(message, "header", None)
    pose = message.pose if header is not None else message
    pose = getattr(pose, "pose", pose)  # with a covariance
    topics.add(topic, header, received, _pose_values(pose.position, pose.orientation))


def _transform(topics: _Topics, topic: str, message: Any, received: float) -> None:
    moved = message.transform
    topics.add(topic, message.header, received, _pose_values(moved.translation, moved.rotation))


def _tf(topics: _Topics, topic: str, message: Any, received: float) -> None:
    fixed = "static" in topic
    for stamped in message.transforms:
        header, moved = stamped.header, stamped.transform
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9
        place, turn = moved.translation, moved.rotation
        values = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        parent, child = header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
        if np.isfinite(values).all() and any(values[3:]):
            topics.transforms.append(Transform(parent, child, stamp or received, values, fixed))
        else:
            topics.no_poses.append(child)  # tf2 ignores them too
        topics.messages += 1


def _joints(topics: _Topics, topic: str, message: Any, received: float) -> None:
    position, velocity = (np.atleast_1d(series) for series in (message.position, message.velocity))
    values = {f"joint:{name}": float(angle) for name, angle in zip(message.name, position, strict=False)}
    values |= {f"rate:{name}": float(rate) for name, rate in zip(message.name, velocity, strict=False)}
    if values:
        topics.add(topic, message.header, received, values)


def _imu(topics: _Topics, topic: str, message: Any, received: float) -> None:
    """Accelerometer and gyroscope; the orientation is seldom filled in, and then not in the sensor's axes."""
    rate = _vector("angular_velocity", message.angular_velocity)
    topics.add(topic, message.header, received, _vector("linear_acceleration", message.linear_acceleration) | rate)


def _temperature(topics: _Topics, topic: str, message: Any, received: float) -> None:
    topics.add(topic, message.header, received, {"temperature": float(message.temperature)})


EXTRACTORS: Mapping[str, Callable[[_Topics, str, Any, float], None]] = {
    "geometry_msgs/msg/WrenchStamped": _wrench,
    "geometry_msgs/msg/Wrench": _wrench,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose,
    "geometry_msgs/msg/Pose": _pose,
    "geometry_msgs/msg/TransformStamped": _transform,
    "nav_msgs/msg/Odometry": _pose,
    "sensor_msgs/msg/JointState": _joints,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/Temperature": _temperature,
    "tf/msg/tfMessage": _tf,
    "tf2_msgs/msg/TFMessage": _tf,
}
"""What is read of each message type."""
