"""The rig: arm, limits, workspace and sensor, as a person writes them down in TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from modeling.errors import InputError

STANDARD_GRAVITY = 9.806  # m/s², the value of the chapter and of FORMATS
LARGEST = 1e12  # beyond any length, speed or force that a rig has
PLANAR_CHANNELS = ("fx", "fy", "tau")
SPATIAL_CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")


class Convention(Enum):
    """Sign of the readings: the sensor's wrench on the tool, the tool's on the sensor, or to be found."""

    ON_TOOL = "on_tool"
    ON_SENSOR = "on_sensor"
    AUTO = "auto"


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Joint limits, each (n, 2): low and high. rad, rad/s, rad/s², rad/s³."""

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64] | None = None

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.position)


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """Where the tip may be, low and high in m (world x right, y up); None is no bound."""

    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class SensorDescription:
    """What is known of the sensor, per channel in N or N·m; None where nothing was stated.

    `noise` is the std of one sample, `range` the largest reading either way, `tolerance` the error that the
    user does not care about. `mirror_y`: planar readings whose y runs along the tip.
    """

    noise: Mapping[str, float] | None = None
    range: Mapping[str, float] | None = None
    tolerance: Mapping[str, float] | None = None
    convention: Convention | None = None
    mirror_y: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """A robot with a wrist sensor. Lengths in m, gravity in m/s²; a rig without a robot is valid."""

    name: str = ""
    link_lengths: tuple[float, ...] | None = None
    urdf: str | None = None
    sensor_frame: str | None = None
    tip_length: float | None = None
    gravity: float = STANDARD_GRAVITY
    limits: Limits | None = None
    workspace: Workspace | None = None
    sensor: SensorDescription = SensorDescription()

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The rig of a TOML file; InputError, in one line, when it is not what FORMATS says."""
        path = Path(path)
        try:
            data = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
        except OSError as error:
            reason = error.strerror or "cannot be read"
            raise InputError(what=reason, where=str(path), remedy="give the path of a rig file") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            remedy = "correct the TOML there"
            raise InputError(what=f"not a TOML file: {error}", where=str(path), remedy=remedy) from None
        return cls.from_data(data, where=str(path))

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "rig") -> Self:
        """The rig of a plain dictionary laid out as the TOML file; `where` names it in an InputError."""
        try:
            table = _RigTable.model_validate(dict(data))
        except ValidationError as error:
            raise _input_error(error, where) from None
        return cls(
            **table.robot.model_dump(exclude={"link_lengths"}),
            link_lengths=None if table.robot.link_lengths is None else tuple(table.robot.link_lengths),
            limits=_limits(table.limits),
            workspace=None if table.workspace is None else Workspace(**table.workspace.model_dump()),
            sensor=_sensor(table.sensor),
        )

    def to_data(self) -> dict[str, Any]:
        """The rig as nested dictionaries, lists, numbers and strings, as `from_data` takes them."""
        robot = {"name": self.name, "gravity": self.gravity, "urdf": self.urdf, "tip_length": self.tip_length}
        robot |= {"sensor_frame": self.sensor_frame, "link_lengths": _listed(self.link_lengths)}
        data: dict[str, Any] = {"robot": _stated(robot), "sensor": _sensor_data(self.sensor)}
        if self.limits is not None:
            data["limits"] = _stated({name: _listed(pairs) for name, pairs in vars(self.limits).items()})
        if self.workspace is not None:
            data["workspace"] = _stated({name: _listed(pair) for name, pair in vars(self.workspace).items()})
        return data


def _stated(table: Mapping[str, object]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


def _listed(values: NDArray[np.float64] | tuple[float, ...] | None) -> list[Any] | None:
    return None if values is None else np.asarray(values, dtype=float).tolist()


def _sensor_data(sensor: SensorDescription) -> dict[str, Any]:
    channels = {name: getattr(sensor, name) for name in ("noise", "range", "tolerance")}
    data = {name: dict(values) for name, values in channels.items() if values is not None}
    convention = None if sensor.convention is None else sensor.convention.value
    return _stated({**data, "convention": convention, "mirror_y": sensor.mirror_y})


# ------------------------------------------------------------------ what the tables of the file must be


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST


def _pair(value: object) -> object:
    """A symmetric limit or [low, high] as (low, high)."""
    if _number(value) and float(value) > 0:  # type: ignore[arg-type]
        return (-float(value), float(value))  # type: ignore[arg-type]
    return _interval(value)


def _interval(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) == 2 and all(map(_number, value)) and value[0] < value[1]:
        return (float(value[0]), float(value[1]))
    raise ValueError("a positive number, or [low, high] with low below high, was expected")


def _span(value: object) -> object:
    if _number(value):
        raise ValueError("[low, high] with low below high was expected")
    return _interval(value)


Positive = Annotated[float, Field(gt=0)]
Pair = Annotated[tuple[float, float], BeforeValidator(_pair)]
Span = Annotated[tuple[float, float], BeforeValidator(_span)]
Channel = Literal["fx", "fy", "fz", "tx", "ty", "tz", "tau"]
PerChannel = Annotated[dict[Channel, Positive], Field(min_length=1)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _RobotTable(_Table):
    name: str = ""
    link_lengths: Annotated[list[Positive], Field(min_length=1)] | None = None
    urdf: str | None = None
    sensor_frame: str | None = None
    tip_length: Positive | None = None
    gravity: Positive = STANDARD_GRAVITY

    @model_validator(mode="after")
    def _one_description(self) -> Self:
        if self.link_lengths is not None and self.urdf is not None:
            raise ValueError("link_lengths or urdf was expected, and both came")
        return self


class _LimitsTable(_Table):
    position: Annotated[list[Pair], Field(min_length=1)]
    velocity: Annotated[list[Pair], Field(min_length=1)]
    acceleration: Annotated[list[Pair], Field(min_length=1)]
    jerk: Annotated[list[Pair], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _same_joints(self) -> Self:
        counts = {name: len(pairs) for name, pairs in self.__dict__.items() if pairs is not None}
        if len(set(counts.values())) > 1:
            raise ValueError(f"as many numbers in each list as joints were expected, and {counts} came")
        return self


class _WorkspaceTable(_Table):
    x: Span | None = None
    y: Span | None = None


class _SensorTable(_Table):
    noise: PerChannel | None = None
    range: PerChannel | None = None
    tolerance: PerChannel | None = None
    convention: Literal["on_tool", "on_sensor", "auto"] | None = None
    mirror_y: bool = False

    @model_validator(mode="after")
    def _one_dimension(self) -> Self:
        named = {channel for table in (self.noise, self.range, self.tolerance) for channel in table or ()}
        if not (named <= set(PLANAR_CHANNELS) or named <= set(SPATIAL_CHANNELS)):
            raise ValueError(f"channels of a planar or of a six-axis sensor were expected, not {sorted(named)}")
        return self


class _RigTable(_Table):
    robot: _RobotTable = _RobotTable()
    limits: _LimitsTable | None = None
    workspace: _WorkspaceTable | None = None
    sensor: _SensorTable = _SensorTable()

    @model_validator(mode="after")
    def _limits_fit_the_arm(self) -> Self:
        lengths, limits = self.robot.link_lengths, self.limits
        if lengths is not None and limits is not None and len(lengths) != len(limits.position):
            counts = f"{len(lengths)} link_lengths and {len(limits.position)} limits came"
            raise ValueError(f"limits of each joint of robot.link_lengths were expected, and {counts}")
        return self


def _limits(table: _LimitsTable | None) -> Limits | None:
    if table is None:
        return None
    arrays = {name: np.array(pairs, dtype=float) for name, pairs in table if pairs is not None}
    for array in arrays.values():
        array.flags.writeable = False
    return Limits(**arrays)


def _sensor(table: _SensorTable) -> SensorDescription:
    convention = None if table.convention is None else Convention(table.convention)
    return SensorDescription(**table.model_dump(exclude={"convention"}), convention=convention)


# ---------------------------------------------------------------------- what pydantic says, in one line


def _input_error(error: ValidationError, where: str) -> InputError:
    first = error.errors(include_url=False)[0]
    key = _key(first["loc"])
    remedy = "correct it in the rig file"
    came = f", and {_shown(first['input'])} came"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        what, remedy = "is not a key that a rig has", f"use one of {_known(first['loc'])}, or remove it"
    elif first["type"] == "missing":
        what, remedy = "was expected and is missing", "add it to the rig file"
    else:
        what = message if "came" in message or "not [" in message else message + came
    return InputError(where=where, what=f"{key}: {what}" if key else what, remedy=remedy)


def _key(location: tuple[int | str, ...]) -> str:
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}"
    return key.lstrip(".").removesuffix(".[key]")


def _known(location: tuple[int | str, ...]) -> str:
    tables: dict[str, type[_Table]] = {"robot": _RobotTable, "limits": _LimitsTable}
    tables |= {"workspace": _WorkspaceTable, "sensor": _SensorTable}
    table = tables.get(str(location[0]), _RigTable) if len(location) > 1 else _RigTable
    return ", ".join(table.model_fields)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
