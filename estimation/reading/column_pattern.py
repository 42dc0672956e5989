"""Column patterns: how robots, drivers and recorders name time, wrench, pose and joints; and the presets."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from modeling.rig import SPATIAL_CHANNELS


class Quantity(Enum):
    """What a group of columns measures."""

    TIME = "time"
    WRENCH = "wrench"
    POSE = "pose"
    ORIENTATION = "orientation"
    POSITION = "position"
    JOINTS = "joint angles"
    VERTICAL = "direction of gravity"
    RATE = "angular velocity"
    SIGNAL = "other signals"


@dataclass(frozen=True, kw_only=True)
class ColumnPattern:
    """Names of one vector's columns, by a regular expression with the groups `stem` and `part`, case ignored.

    parts        the parts of the vector in their order; those of a numbered one are found from 0 or from 1 on
    form         name of the orientation's form, "" where the content decides or there is none
    base_axes    whether a wrench is given along the axes of the robot's base
    compensated  whether the weight of a payload is taken out of it already
    """

    quantity: Quantity
    regex: str
    parts: tuple[str, ...] = ()
    form: str = ""
    base_axes: bool = False
    compensated: bool = False
    preset: str = ""

    def matched(self, name: str) -> tuple[str, str] | None:
        """Stem and part of a column's name; None when it does not match."""
        match = re.fullmatch(self.regex, name, re.IGNORECASE)
        if match is None:
            return None
        groups = match.groupdict()
        kind = (groups.get("kind") or "").lower()
        component = (groups.get("part") or "").lower()
        if kind:
            component = ("f" if kind.startswith("f") else "t") + component
        return (groups.get("stem") or "").strip("._/[ :-"), component


_SEP = r"[\[\]_./: -]*"
_INDEX = r"[\[_./ ]+(?P<part>\d+)\]?"
XYZ = tuple("xyz")


def _numbered(quantity: Quantity, stem: str, count: int, **more: object) -> ColumnPattern:
    parts = tuple(str(i) for i in range(count))
    regex = rf"(?P<stem>{stem}){_INDEX}"
    return ColumnPattern(quantity=quantity, regex=regex, parts=parts, **more)  # type: ignore[arg-type]


PATTERNS: tuple[ColumnPattern, ...] = (
    # Universal Robots, RTDE: the pose is a rotation vector, the force along base axes about the TCP.
    _numbered(Quantity.WRENCH, r".*ft_raw_wrench", 6, preset="ur_rtde"),
    _numbered(Quantity.WRENCH, r".*actual_TCP_force", 6, base_axes=True, compensated=True, preset="ur_rtde"),
    _numbered(Quantity.POSE, r".*actual_TCP_pose", 6, form="rotation_vector", preset="ur_rtde"),
    _numbered(Quantity.JOINTS, r".*actual_q", 0, preset="ur_rtde"),
    # Franka: 4 x 4 column by column; the wrenches are estimated, without the configured load.
    _numbered(Quantity.WRENCH, r".*K_F_ext_hat_K", 6, compensated=True, preset="franka"),
    _numbered(Quantity.WRENCH, r".*O_F_ext_hat_K", 6, base_axes=True, compensated=True, preset="franka"),
    _numbered(Quantity.ORIENTATION, r".*O_T_EE", 16, form="matrix_columns", preset="franka"),
    # Anybody's.
    ColumnPattern(
        quantity=Quantity.WRENCH,
        regex=rf"(?P<stem>(?:.*[^a-z])?)(?P<kind>force|torque|moment|f|t|m){_SEP}(?P<part>[xyz])",
        parts=SPATIAL_CHANNELS,
    ),
    ColumnPattern(quantity=Quantity.WRENCH, regex=r"(?P<stem>)(?P<part>fx|fy|tau)", parts=("fx", "fy", "tau")),
    _numbered(Quantity.WRENCH, r".*(?:wrench|force|f_ext|ft_?sensor|(?:^|[^a-z])ft|loadcell)[^\d]*", 6),
    ColumnPattern(
        quantity=Quantity.ORIENTATION,
        regex=rf"(?P<stem>(?:.*[^a-z])?)(?:orientation|rotation|quaternion|quat|rot|ori|q){_SEP}(?P<part>[xyzw])",
        parts=tuple("xyzw"),
        form="xyzw",
    ),
    ColumnPattern(quantity=Quantity.ORIENTATION, regex=r"(?P<stem>)(?P<part>phi)", parts=("phi",), form="planar"),
    _numbered(Quantity.POSE, r".*(?:pose|tracker|transform)[^\d]*", 7, form="xyzw"),
    _numbered(Quantity.ORIENTATION, r".*(?:pose|transform|matrix|_T_)[^\d]*", 16),
    _numbered(Quantity.ORIENTATION, r".*(?:orientation|quat|rotation)[^\d]*", 4, form="xyzw"),
    _numbered(Quantity.ORIENTATION, r".*(?:rotation|matrix|(?:^|[^a-z])r|rot)[^\d]*", 9),
    # Euler angles, where nothing else tells the orientation: KUKA turns about moving z, y, x, Fanuc and xArm about
    # fixed x, y, z, as roll, pitch and yaw are mostly meant. A reading of other axes is compared with it afterwards.
    ColumnPattern(
        quantity=Quantity.POSE, regex=r"(?P<stem>(?:.*[^a-z])?)(?P<part>[xyzabc])", parts=tuple("xyzabc"),
        form="euler ZYX",
    ),
    ColumnPattern(
        quantity=Quantity.POSE, regex=r"(?P<stem>(?:.*[^a-z])?)(?P<part>[xyzwpr])", parts=tuple("xyzwpr"),
        form="euler xyz",
    ),
    ColumnPattern(
        quantity=Quantity.ORIENTATION, regex=r"(?P<stem>(?:.*[^a-z])?)(?P<part>roll|pitch|yaw)",
        parts=("roll", "pitch", "yaw"), form="euler xyz",
    ),
    ColumnPattern(
        quantity=Quantity.POSITION,
        regex=rf"(?P<stem>(?:.*[^a-z])?)(?:position|pos|translation|p|){_SEP}(?P<part>[xyz])",
        parts=XYZ,
    ),
    _numbered(Quantity.POSITION, r".*(?:position|pos|translation)[^\d]*", 3),
    ColumnPattern(
        quantity=Quantity.VERTICAL,
        regex=r"(?P<stem>(?:.*[^a-z])?)(?:linear_?acceleration|acceleration|accelerometer|acc(?:el)?|a)"
        rf"{_SEP}(?P<part>[xyz])",
        parts=XYZ,
        form="accelerometer",
    ),
    ColumnPattern(
        quantity=Quantity.VERTICAL,
        regex=rf"(?P<stem>(?:.*[^a-z])?)(?:gravity|grav|g){_SEP}(?P<part>[xyz])",
        parts=XYZ,
        form="gravity",
    ),
    ColumnPattern(
        quantity=Quantity.RATE,
        regex=r"(?P<stem>(?:.*[^a-z])?)(?:angular_?(?:velocity|rate)|gyro(?:scope)?|omega|w)"
        rf"{_SEP}(?P<part>[xyz])",
        parts=XYZ,
    ),
    ColumnPattern(quantity=Quantity.JOINTS, regex=r"(?P<stem>joint):(?P<part>.+)"),
    ColumnPattern(
        quantity=Quantity.JOINTS,
        regex=r"(?P<stem>(?:.*[^a-z])?(?:q|joint|joint_?pos(?:ition)?s?|position|theta|axis)s?)"
        r"[\[\]_./ ]*(?P<part>\d+)\]?",
    ),
    ColumnPattern(quantity=Quantity.JOINTS, regex=r"(?P<stem>.*joint_states?)/(?P<part>[^/]+)/position"),
)  # fmt: skip
"""In order of preference: what a robot states of itself before what its names suggest."""

TIME_NAMES: tuple[str, ...] = (
    r".*header[._/]stamp", r"time", r"stamp", r"_*time", r"%?time", r"time_?stamps?", r"t",
    r".*(?:^|[^a-z])time_?stamps?",
    r".*(?:^|[^a-z])(?:time|stamp|zeit|seconds|sec)", r"(?:robot|elapsed|system|unix|epoch).?time", r"time.*", r"clock",
)  # fmt: skip
"""Names of the time, best first: the sensor's own stamp in its header, then the recorder's, of receipt."""
SECONDS, NANOSECONDS = r"(?P<stem>.*(?:^|[^a-z]))secs?", r"(?P<stem>.*(?:^|[^a-z]))n(?:ano)?secs?"

PRESETS: Mapping[str, str] = {
    "ur_rtde": "Universal Robots, record of the RTDE client: actual_TCP_pose_*, actual_TCP_force_*, ft_raw_wrench_*",
    "franka": "Franka, state log: O_T_EE[*], O_F_ext_hat_K[*], K_F_ext_hat_K[*]",
    "ros_csv": "rostopic echo -p, and ros2 topic echo --csv of a WrenchStamped (without header)",
    "ros_bag": "ROS 1 and ROS 2 bags",
    "plotjuggler": "PlotJuggler's CSV export: __time, /topic/wrench/force/x",
    "orocos": "Orocos reporting: TimeStamp, port.0",
    "kinova": "one headerless file each of joint positions, wrench and time, equally many rows",
    "xyz_quaternion_wrench": "headerless: time, x, y, z, quaternion x y z w, force, torque",
    "joints_deg_wrench": "headerless: joints in degrees, then force and torque",
}
"""Names of the presets and what each is for."""
PRESET_COLUMNS: Mapping[str, str] = {
    "ur_rtde": r"actual_(tcp|q)|ft_raw_wrench",
    "franka": r"O_T_EE|_F_ext_hat_K",
    "plotjuggler": r"^__time$",
    "orocos": r"^TimeStamp$|\.\d+$",
}
"""What a column's name has where a preset fits; presets of bags and of files without header are known otherwise."""
