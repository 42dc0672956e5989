"""The rig: arm, limits, workspace and sensor, read from a TOML file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from modeling.compiled.cache import cached
from modeling.errors import InputError, file_text, toml_data
from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.kinematics.placement import (
    Body,
    Direction,
    Placement,
    Vector3,
    base_placement,
    rotated_vector,
    translated,
    unit_direction,
)
from modeling.rigid_body import Load
from modeling.table import Table, shortened

UNITS = {"link_lengths": "m", "tip_length": "m", "gravity": "m/s²", "x": "m", "y": "m", "z": "m"}
"""Units of entries by their last key."""
RATES = {"position": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³", "start": "", "end": ""}
"""Suffixes of the unit of a joint's limits to the unit of its coordinate."""
LOADS = {"torque": "", "coulomb": "", "viscous": " s"}
"""Suffixes of the unit of a joint's torque and friction to N m, or to N over the unit of its coordinate."""
CHANNELS = ("noise", "range", "tolerance")
"""Entries with a number for each channel, N or N m."""


def rig_table(data: Mapping[str, Any], joint_unit: str = "rad") -> Table:
    """Of the rig's plain data; an arm that was read from a URDF is the URDF's name."""
    rows = [
        (name, _text(value), _unit(name.rpartition(".")[2], joint_unit))
        for name, value in _entries(data)
        if name != "robot.name" and value not in (False, "")
    ]
    return Table.of(("stated", "value", "unit"), rows)


def _entries(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for section, table in data.items():
        if isinstance(table, list):
            yield f"[[{section}]]", len(table)
            continue
        for key, value in table.items():
            if key != "spatial_arm":
                yield f"{section}.{key}", value


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(element)}" for name, element in value.items())
    if isinstance(value, list):
        inner = ", ".join(_text(element) for element in value)
        return f"[{inner}]" if value and not isinstance(value[0], list) else inner
    return f"{value:g}" if isinstance(value, float) else str(value)


def _unit(key: str, joint_unit: str) -> str:
    if key in RATES:
        return " or ".join(unit + RATES[key] for unit in joint_unit.split(" or "))
    if key in LOADS:
        torques = {"rad": "N m" + LOADS[key], "m": "N" + LOADS[key] + ("/m" if LOADS[key] else "")}
        return " or ".join(torques[unit] for unit in joint_unit.split(" or "))
    return "N, N m" if key in CHANNELS else UNITS.get(key, "")


RigTables: TypeAlias = dict[str, Any]
"""Validated rig data, as returned by `modeling.rig_schema.validated_tables`."""

STANDARD_GRAVITY = 9.806
"""m/s²: the value of chapter 22 (Bassi et al.) and of the file formats."""
CURRENT_FOLDER = Path()
_CONVERTED = ("link_lengths", "spatial_arm", "gravity_direction")
"""Entries of [robot] that the rig keeps in another form."""
PLANAR_CHANNELS = ("fx", "fy", "tau")
SPATIAL_CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")


class Convention(Enum):
    """Sign convention of the readings: wrench of sensor on tool, of tool on sensor, or to be estimated."""

    ON_TOOL = "on_tool"
    ON_SENSOR = "on_sensor"
    AUTO = "auto"


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueLimits:
    """Limits of the joints' torques, and what they have to move. N m; N of prismatic joints.

    allowed  (n, 2): low and high
    bodies   what the joints move: the arm's links and what it carries
    viscous  (n,): friction over speed, N m s/rad (N s/m)
    coulomb  (n,): friction against the motion, whatever its speed
    gravity  m/s², along -z of the world
    """

    allowed: NDArray[np.float64]
    bodies: tuple[Body, ...]
    viscous: NDArray[np.float64]
    coulomb: NDArray[np.float64]
    gravity: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Joint limits, each (n, 2): low and high. rad, rad/s, rad/s², rad/s³; m instead of rad for prismatic joints.

    torque      of the joints
    start, end  (n,): where a motion from rest to rest begins and ends
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64] | None = None
    torque: TorqueLimits | None = None
    start: NDArray[np.float64] | None = None
    end: NDArray[np.float64] | None = None

    @property
    def pairs(self) -> dict[str, NDArray[np.float64]]:
        """Low and high of the stated derivatives of position, by name."""
        named = {name: getattr(self, name) for name in ("position", "velocity", "acceleration", "jerk")}
        return {name: pairs for name, pairs in named.items() if pairs is not None}

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.position)


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """All points within `radius` of a segment that moves with a link of a spatial arm; a ball where it is one point.

    joint       joints that move it, from the base; 0: it is fixed in the world, an obstacle
    start, end  of the segment, m, in the frame that the last of them moves (the world, z up, of an obstacle)
    """

    name: str
    joint: int
    start: Vector3
    end: Vector3
    radius: float


@dataclass(frozen=True, kw_only=True)
class HalfSpace:
    """Where the capsules of the arm stay: normal . p + offset >= clearance for all their points, m, in the world, z up.

    normal is a unit vector.
    """

    normal: Vector3
    offset: float
    clearance: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """Where the arm may move.

    x, y, z      allowed box of the tip, low and high in m (planar: x right, y up; in space: z up); None is unbounded
    capsules     of the arm's links and of obstacles, which keep `clearance` (m) from one another
    half_spaces  in which the capsules of the arm's links stay
    """

    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None
    z: tuple[float, float] | None = None
    clearance: float = 0.0
    capsules: tuple[Capsule, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()

    @property
    def sides(self) -> dict[str, tuple[float, float]]:
        """The stated sides of the tip's box, by axis."""
        return {axis: side for axis in "xyz" if (side := getattr(self, axis)) is not None}


@dataclass(frozen=True, kw_only=True)
class SensorDescription:
    """Stated properties of the sensor, per channel in N or N·m; None where not stated.

    `noise` is the std of one sample, `range` the largest absolute reading, `tolerance` the largest acceptable error.
    `mirror_y`: planar readings whose y axis points along the tip.
    """

    noise: Mapping[str, float] | None = None
    range: Mapping[str, float] | None = None
    tolerance: Mapping[str, float] | None = None
    convention: Convention | None = None
    mirror_y: bool = False


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rig:
    """A robot with a wrist sensor, as a rig file describes it; a rig without a robot is valid.

    Parameters
    ----------
    name : str, optional
        For messages.
    link_lengths : tuple of float, optional
        Of a planar arm, m.
    urdf : str, optional
        Path of the arm's URDF, as given.
    sensor_frame : str, optional
        Link of the URDF that carries the sensor.
    spatial_arm : SpatialArm, optional
        The kinematic chain read from the URDF up to `sensor_frame`.
    tip_length : float, optional
        From the sensor origin to the end of the tool, m.
    gravity : float, optional
        m/s², by default 9.806.
    gravity_direction : tuple of float, optional
        Unit vector along gravity in base axes, (x, y) in the plane, (x, y, z) in six axes; by default along -y, -z. The
        world is then the base turned by the least angle that points gravity down.
    limits : Limits, optional
        Of joint position, velocity and acceleration, perhaps jerk and torque; rad, rad/s, rad/s², rad/s³, N m.
    workspace : Workspace, optional
        Where the tip has to stay, m.
    sensor : SensorDescription, optional
        Noise, range, convention and tolerance of the sensor, where stated.
    columns : mapping, optional
        Names of the columns of this rig's logs, as in a map of `truewrench import`.
    loads : tuple of (str, Load), optional
        What recordings carried beside the tool: the name of a file, with as many of its folders as tell it, and a load.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> rig.link_lengths, rig.gravity
    ((1.0, 0.97, 0.4), 9.806)
    """

    name: str = ""
    link_lengths: tuple[float, ...] | None = None
    urdf: str | None = None
    sensor_frame: str | None = None
    spatial_arm: SpatialArm | None = None
    tip_length: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_direction: Direction | None = None
    limits: Limits | None = None
    workspace: Workspace | None = None
    sensor: SensorDescription = SensorDescription()
    columns: Mapping[str, Any] | None = None
    loads: tuple[tuple[str, Load], ...] = ()

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The rig of a TOML file; InputError when it, or its URDF, does not conform to FORMATS."""
        path = Path(path)
        text = file_text(path, kind="a rig file")
        # Cached by its text: importing the validator takes longer than the rest of reading a rig.
        checked = cached({"rig": text}, lambda: _tables_of_text(text, str(path)), dict)
        return cls._of_tables(checked, where=str(path), folder=path.parent)

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "rig", folder: Path = CURRENT_FOLDER) -> Self:
        """The rig of a plain dictionary with the structure of the TOML file, or as returned by `to_data`.

        `where` is its name in an InputError; a relative URDF path starts at `folder`.
        """
        from modeling.rig_schema import validated_tables  # pydantic is slow to import

        return cls._of_tables(validated_tables(data, where), where=where, folder=folder)

    @classmethod
    def _of_tables(cls, tables: RigTables, *, where: str, folder: Path) -> Self:
        robot = tables["robot"]
        lengths, arm, direction = robot["link_lengths"], _spatial_arm(robot, where, folder), robot["gravity_direction"]
        return cls(
            **_stated({key: value for key, value in robot.items() if key not in _CONVERTED}),
            gravity_direction=None if direction is None else unit_direction(direction),
            link_lengths=None if lengths is None else tuple(lengths),
            spatial_arm=arm,
            limits=_limits(tables, arm, where, folder),
            workspace=_workspace(tables, arm, where, folder),
            sensor=_sensor(tables["sensor"]),
            columns=tables["columns"],
            loads=_loads(tables["load"], where),
        )

    @cached_property
    def arm(self) -> Arm | None:
        """Forward kinematics from the joints to the sensor in the world; None when the rig states no arm."""
        arm = self.spatial_arm if self.link_lengths is None else PlanarArm(self.link_lengths)
        direction = self.gravity_direction
        return arm if arm is None or direction is None else arm.mounted(direction)

    def loads_of(self, path: str | Path) -> tuple[Load, ...]:
        """What the recording in a file carried beside the tool."""
        parts = Path(path).parts
        return tuple(load for name, load in self.loads if parts[-len(Path(name).parts) :] == Path(name).parts)

    @property
    def table(self) -> Table:
        """What the rig file states, by its names."""
        units = ("rad",) if self.arm is None else self.arm.units
        return rig_table(self.to_data(), " or ".join(sorted(set(units), reverse=True)))

    def __repr__(self) -> str:
        return f"{self._title}\n{shortened(str(self.table))}"

    def _repr_html_(self) -> str:
        from html import escape  # in notebooks alone

        return f"<p>{escape(self._title)}</p>\n{self.table.to_html()}"

    @property
    def _title(self) -> str:
        return f"Rig {self.name!r}" if self.name else "Rig"

    @property
    def position_limits(self) -> NDArray[np.float64] | None:
        """Lowest and highest joint coordinates (n, 2): those stated, else the URDF's; None without either."""
        if self.limits is not None:
            return self.limits.position
        return None if self.spatial_arm is None else self.spatial_arm.position_limits

    def to_data(self) -> dict[str, Any]:
        """The rig as nested dictionaries, lists, numbers and strings, accepted by `from_data`."""
        robot = {"name": self.name, "gravity": self.gravity, "urdf": self.urdf, "tip_length": self.tip_length}
        robot |= {"sensor_frame": self.sensor_frame, "link_lengths": _listed(self.link_lengths)}
        robot |= {"gravity_direction": _listed(self.gravity_direction)}
        if self.spatial_arm is not None:
            from modeling.rig_schema import SPATIAL_ARM  # pydantic is slow to import

            robot |= {"spatial_arm": SPATIAL_ARM.dump_python(self.spatial_arm, mode="json")}
        data: dict[str, Any] = {"robot": _stated(robot), "sensor": _sensor_data(self.sensor)}
        if self.columns is not None:
            data["columns"] = dict(self.columns)
        if self.loads:
            data["load"] = [{"recording": name} | load.to_data() for name, load in self.loads]
        if self.limits is not None:
            data |= _limits_data(self.limits)
        if self.workspace is not None:
            data |= _workspace_data(self.workspace)
        return data


def _stated(table: Mapping[str, object]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


def _loads(tables: Sequence[Mapping[str, Any]], where: str) -> tuple[tuple[str, Load], ...]:
    """Each load with the recording that it is of."""
    loads: list[tuple[str, Load]] = []
    for table in tables:
        named = table["recording"]
        load = Load.from_data(table)
        loads += [(name, load) for name in ([named] if isinstance(named, str) else named)]
    if empty := next((load for name, load in loads if not Path(name).parts), None):
        raise InputError(what=f"load {empty}: recording is empty", where=where, remedy="name a file")
    return tuple(loads)


def _listed(values: NDArray[np.float64] | tuple[float, ...] | None) -> list[Any] | None:
    return None if values is None else np.asarray(values, dtype=float).tolist()


def _sensor_data(sensor: SensorDescription) -> dict[str, Any]:
    channels = {name: getattr(sensor, name) for name in ("noise", "range", "tolerance")}
    data = {name: dict(values) for name, values in channels.items() if values is not None}
    convention = None if sensor.convention is None else sensor.convention.value
    return _stated({**data, "convention": convention, "mirror_y": sensor.mirror_y})


def _tables_of_text(text: str, where: str) -> RigTables:
    """The tables in the text of a TOML file; InputError where they do not conform to FORMATS."""
    from modeling.rig_schema import validated_tables  # pydantic is slow to import

    return validated_tables(toml_data(text, where), where)


def _spatial_arm(robot: Mapping[str, Any], where: str, folder: Path) -> SpatialArm | None:
    """The arm stored in the rig data, or read from its URDF."""
    if robot["spatial_arm"] is not None:
        from modeling.rig_schema import SPATIAL_ARM  # pydantic is slow to import

        return SPATIAL_ARM.validate_python(robot["spatial_arm"])
    if robot["urdf"] is None:
        return None
    path = folder / robot["urdf"]
    if not path.exists():
        what = f"urdf: there is no file {robot['urdf']} in {folder.absolute()}, the folder of the rig file"
        raise InputError(what=what, where=where, remedy="give its path from that folder, or an absolute one")
    arm: SpatialArm = _urdf_reader().read_urdf(path, robot["sensor_frame"])
    return arm


def _urdf_reader() -> ModuleType:
    from modeling.kinematics import urdf  # the XML parser is slow to import

    return urdf


def _limits_data(limits: Limits) -> dict[str, Any]:
    """The sections of the rig's data that the limits are made of."""
    torque = limits.torque
    given = limits.pairs | {
        "start": limits.start,
        "end": limits.end,
        "torque": None if torque is None else torque.allowed,
    }
    data: dict[str, Any] = {"limits": _stated({name: _listed(values) for name, values in given.items()})}
    if torque is not None:
        listed = [dict(vars(body)) for body in torque.bodies]
        data["body"] = [{k: list(v) if isinstance(v, tuple) else v for k, v in body.items()} for body in listed]
        data["friction"] = {"viscous": _listed(torque.viscous), "coulomb": _listed(torque.coulomb)}
    return data


def _limits(tables: RigTables, arm: SpatialArm | None, where: str, folder: Path) -> Limits | None:
    """The limits of the tables; missing position and velocity limits are taken from the URDF."""
    table = tables["limits"]
    if table is None or table["torque"] is None:
        if tables["body"] or tables["friction"] is not None:
            what = "[[body]] and [friction] are of joints with torque limits, and the rig states none"
            raise InputError(what=what, where=where, remedy="state limits.torque, or leave them out")
        if table is None:
            return None
    counts = [len(pairs) for pairs in table.values() if isinstance(pairs, list)]
    if arm is not None and any(count != arm.joints for count in counts):
        what = f"limits: expected {arm.joints} joints, got {min(counts)} limits"
        raise InputError(
            what=what, where=where, remedy=f"give limits of {', '.join(j.name for j in arm.chain)}, in this order"
        )
    stated: dict[str, Any] = {name: values for name, values in table.items() if name != "torque"}
    for name in ("position", "velocity", "acceleration"):
        if stated[name] is None:
            stated[name] = _limits_of_urdf(arm, name, where)
    arrays = {name: _constant(values) for name, values in stated.items() if values is not None}
    if "end" in arrays and "start" not in arrays:
        raise InputError(what="limits.end is stated, and no start", where=where, remedy="state limits.start too")
    return Limits(**arrays, torque=_torque(tables, arm, where, folder) if table["torque"] is not None else None)


def _constant(values: Any) -> NDArray[np.float64]:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def _torque(tables: RigTables, arm: SpatialArm | None, where: str, folder: Path) -> TorqueLimits:
    """The torque limits of the tables, with the masses and the friction of the URDF where it is read."""
    robot, asked, friction = tables["robot"], tables["limits"]["torque"], tables["friction"] or {}
    if arm is None:
        what = "limits.torque: the masses of links are read from a URDF, and the rig states none"
        raise InputError(what=what, where=where, remedy="state robot.urdf, or leave it out")
    drives, links = None, {}
    if robot["spatial_arm"] is None:
        path = folder / robot["urdf"]
        drives = _urdf_reader().drive_data(path, robot["sensor_frame"])
        links = _urdf_reader().link_frames(path, robot["sensor_frame"])
    if asked == "urdf":
        weak = [
            joint.name for joint, effort in zip(arm.chain, drives.effort if drives else (), strict=False) if effort <= 0
        ]
        if drives is None or weak:
            what = (
                f"limits.torque: the URDF states no effort of '{weak[0]}'"
                if weak
                else "limits.torque: there is no URDF"
            )
            raise InputError(what=what, where=where, remedy="give the torque of each joint, N m")
        asked = [(-effort, effort) for effort in drives.effort]
    stated = [_carried(n, body, links, arm, where) for n, body in enumerate(tables["body"])]
    bodies = (*(drives.bodies if drives else ()), *stated)
    if not bodies:
        what = "limits.torque: no link that the joints move has a mass"
        raise InputError(
            what=what, where=where, remedy="add <inertial> to the links of the URDF, or [[body]] to the rig"
        )
    resisting = {}
    for name, of_urdf in (("viscous", "damping"), ("coulomb", "friction")):
        values = friction.get(name) or (getattr(drives, of_urdf) if drives else (0.0,) * arm.joints)
        if len(values) != arm.joints or min(values) < 0:
            what = f"friction.{name}: expected zero or more for each of {arm.joints} joints, got {list(values)}"
            raise InputError(what=what, where=where, remedy="correct it there, or <dynamics> in the URDF")
        resisting[name] = _constant(values)
    return TorqueLimits(
        allowed=_constant(asked), bodies=bodies, gravity=robot["gravity"] or STANDARD_GRAVITY, **resisting
    )


def _carried(number: int, table: Mapping[str, Any], links: Mapping[str, Any], arm: SpatialArm, where: str) -> Body:
    """The body of a table, in the frame that its last joint moves."""
    joint, frame = _place(f"body[{number}]", table, links, arm, where)
    if joint == 0:
        what = f"body[{number}]: the base moves it, and no joint"
        raise InputError(what=what, where=where, remedy="name the link, or the number of joints, that moves it")
    own = Body(joint=0, mass=table["mass"], centre=table["centre"], inertia=table["inertia"])
    return own.moved(frame, joint)


def _limits_of_urdf(arm: SpatialArm | None, name: str, where: str) -> list[tuple[float, float]]:
    chain = () if arm is None else arm.chain
    unlimited = [joint.name for joint in chain if getattr(joint, name, None) is None]
    if unlimited or not chain:
        reason = f", and the URDF has none for '{unlimited[0]}'" if unlimited else ""
        what = f"limits.{name}: missing{reason}"
        raise InputError(what=what, where=where, remedy="add it to the rig file")
    return [getattr(joint, name) for joint in chain]


def _workspace_data(workspace: Workspace) -> dict[str, Any]:
    """The sections of the rig's data that the workspace is made of."""
    box: dict[str, Any] = {axis: list(side) for axis, side in workspace.sides.items()}
    if workspace.clearance:
        box["clearance"] = workspace.clearance
    solids = {"capsule": workspace.capsules, "half_space": workspace.half_spaces}
    listed = {name: [dict(vars(solid)) for solid in some] for name, some in solids.items() if some}
    for solid in (solid for some in listed.values() for solid in some):
        solid |= {key: list(value) for key, value in solid.items() if isinstance(value, tuple)}
    return {"workspace": box} | listed


def _workspace(tables: RigTables, arm: SpatialArm | None, where: str, folder: Path) -> Workspace | None:
    """The box, the capsules and the half-spaces that the tables state; None where they state none."""
    box, capsules, half_spaces = tables["workspace"], tables["capsule"], tables["half_space"]
    if box is None and not capsules and not half_spaces:
        return None
    if (capsules or half_spaces) and arm is None:
        what = "[[capsule]] and [[half_space]] are of arms that are read from a URDF, and the rig states none"
        raise InputError(what=what, where=where, remedy="state robot.urdf, or leave them out")
    robot, sides = tables["robot"], {} if box is None else _stated(box)
    path, fitted, links = folder / (robot["urdf"] or ""), list[Capsule](), {}
    direction = robot["gravity_direction"]
    base = Placement() if arm is None or direction is None else base_placement(unit_direction(direction))
    if sides.get("capsules") is not None:
        if robot["urdf"] is None or robot["spatial_arm"] is not None:
            what = 'workspace.capsules: "urdf" is of arms that are read from one, and the rig names none'
            raise InputError(what=what, where=where, remedy="state robot.urdf, or leave it out")
        stated = {capsule["link"] for capsule in capsules}
        for name, joint, start, end, radius in _urdf_reader().collision_capsules(path, robot["sensor_frame"], stated):
            start, end = _placed((start, end), Placement() if joint else base)
            fitted.append(Capsule(name=name, joint=joint, start=start, end=end, radius=radius))
        if not fitted and not stated:
            what = "workspace.capsules: no link of the URDF has collision geometry"
            raise InputError(what=what, where=where, remedy="state [[capsule]] of the links")
    if any(capsule["link"] is not None for capsule in capsules) and robot["urdf"]:
        frames = _urdf_reader().link_frames(path, robot["sensor_frame"])
        links = {name: (joint, frame if joint else base.then(frame)) for name, (joint, frame) in frames.items()}
    listed = [_capsule(n, table, links, arm, where) for n, table in enumerate(capsules, start=1)]
    if half_spaces and not any(capsule.joint for capsule in (*listed, *fitted)):
        what = "[[half_space]]: no [[capsule]] moves with the arm, to be kept inside"
        raise InputError(what=what, where=where, remedy="add the capsules of the arm's links")
    return Workspace(
        **{axis: (sides[axis][0], sides[axis][1]) for axis in "xyz" if axis in sides},
        clearance=sides.get("clearance", 0.0),
        capsules=(*listed, *fitted),
        half_spaces=tuple(_half_space(table) for table in half_spaces),
    )


def _capsule(
    number: int, table: Mapping[str, Any], links: Mapping[str, Any], arm: SpatialArm | None, where: str
) -> Capsule:
    """The capsule of a table, in the frame that its last joint moves."""
    joint, frame = _place(f"capsule[{number - 1}]", table, links, arm, where)
    start, end = _placed((table["start"], table["end"] or table["start"]), frame)
    name = table["name"] or table["link"] or (f"capsule {number}" if joint else f"obstacle {number}")
    return Capsule(name=name, joint=joint, start=start, end=end, radius=table["radius"])


def _placed(ends: Iterable[Sequence[float]], frame: Placement) -> tuple[Vector3, Vector3]:
    """Both ends of a capsule in the frame in which theirs has this placement."""
    (x, y, z), (i, j, k) = (translated(frame.position, rotated_vector(frame.quaternion, point)) for point in ends)
    return (x, y, z), (i, j, k)


def _place(
    called: str, table: Mapping[str, Any], links: Mapping[str, Any], arm: SpatialArm | None, where: str
) -> tuple[int, Placement]:
    """The joints that move the link that a table names, and its place in the frame that the last of them moves."""
    joint, link = table["joint"] or 0, table["link"]
    if link is not None:
        if link not in links:
            what = f"{called}.link: the URDF has no link '{link}'"
            raise InputError(what=what, where=where, remedy=f"name one of {', '.join(links)}")
        joint, frame = links[link]
        return joint, frame
    if arm is not None and joint > arm.joints:
        what = f"{called}.joint: the arm has {arm.joints} joints, got {joint}"
        raise InputError(
            what=what, where=where, remedy=f"give the number of joints that move the {called.split('[')[0]}"
        )
    return joint, Placement()


def _half_space(table: Mapping[str, Any]) -> HalfSpace:
    """The half-space of a table, its normal of length one."""
    x, y, z = unit_direction(table["normal"])
    return HalfSpace(normal=(x, y, z), offset=table["offset"], clearance=table["clearance"])


def _sensor(table: Mapping[str, Any]) -> SensorDescription:
    stated = table["convention"]
    return SensorDescription(**{**table, "convention": None if stated is None else Convention(stated)})
