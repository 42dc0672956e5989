"""RigFile: the tables that a rig's TOML file may hold, and one line for whatever else it holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from modeling.errors import InputError
from modeling.joint import LARGEST
from modeling.space import Space
from modeling.spatial_arm import SpatialArm

SPATIAL_ARM = TypeAdapter(SpatialArm)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST


def symmetric(value: object) -> object:
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
Pair = Annotated[tuple[float, float], BeforeValidator(symmetric)]
Pairs = Annotated[list[Pair], Field(min_length=1)]
Span = Annotated[tuple[float, float], BeforeValidator(_span)]
Channel = Literal["fx", "fy", "fz", "tx", "ty", "tz", "tau"]
PerChannel = Annotated[dict[Channel, Positive], Field(min_length=1)]


class Table(BaseModel):
    """A table of the file: no other keys, no other types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class RobotTable(Table):
    """[robot]; `spatial_arm` is what stood in the URDF, in a rig that was stored away from it."""

    name: str = ""
    link_lengths: Annotated[list[Positive], Field(min_length=1)] | None = None
    urdf: str | None = None
    sensor_frame: str | None = None
    spatial_arm: Annotated[SpatialArm, BeforeValidator(SPATIAL_ARM.validate_python)] | None = None
    tip_length: Positive | None = None
    gravity: Positive | None = None

    @model_validator(mode="after")
    def _one_description(self) -> Self:
        if self.link_lengths is not None and (self.urdf is not None or self.spatial_arm is not None):
            raise ValueError("link_lengths or urdf was expected, and both came")
        return self


class LimitsTable(Table):
    """[limits], in rad, rad/s, rad/s², rad/s³, m where a joint slides; what it leaves out may stand in a URDF."""

    position: Pairs | None = None
    velocity: Pairs | None = None
    acceleration: Pairs | None = None
    jerk: Pairs | None = None

    @model_validator(mode="after")
    def _same_joints(self) -> Self:
        if len(set(self.counts.values())) > 1:
            raise ValueError(f"as many numbers in each list as joints were expected, and {self.counts} came")
        return self

    @property
    def counts(self) -> dict[str, int]:
        """How many joints each list is for."""
        return {name: len(pairs) for name, pairs in self if pairs is not None}


class WorkspaceTable(Table):
    """[workspace], in m."""

    x: Span | None = None
    y: Span | None = None
    z: Span | None = None


class SensorTable(Table):
    """[sensor], in N and N·m."""

    noise: PerChannel | None = None
    range: PerChannel | None = None
    tolerance: PerChannel | None = None
    convention: Literal["on_tool", "on_sensor", "auto"] | None = None
    mirror_y: bool = False

    @model_validator(mode="after")
    def _one_dimension(self) -> Self:
        named = {channel for table in (self.noise, self.range, self.tolerance) for channel in table or ()}
        if not (named <= set(Space.PLANE.channels) or named <= set(Space.SPACE.channels)):
            raise ValueError(f"channels of a planar or of a six-axis sensor were expected, not {sorted(named)}")
        return self


class RigTable(Table):
    """The whole file."""

    robot: RobotTable = RobotTable()
    limits: LimitsTable | None = None
    workspace: WorkspaceTable | None = None
    sensor: SensorTable = SensorTable()

    @model_validator(mode="after")
    def _limits_fit_the_arm(self) -> Self:
        lengths, limits = self.robot.link_lengths, self.limits
        if lengths is not None and limits is not None and {len(lengths)} != {*limits.counts.values(), len(lengths)}:
            counts = f"{len(lengths)} link_lengths and {min(limits.counts.values())} limits came"
            raise ValueError(f"limits of each joint of robot.link_lengths were expected, and {counts}")
        return self


def tables(data: Mapping[str, object], where: str) -> dict[str, Any]:
    """The tables in these data as plain data, what they leave out as None; InputError where they hold anything else."""
    try:
        return RigTable.model_validate(dict(data)).model_dump(mode="json")
    except ValidationError as error:
        raise refusal(error, where) from None


# ---------------------------------------------------------------------- what pydantic says, in one line


def refusal(error: ValidationError, where: str) -> InputError:
    """The first of the errors as one line about the file `where`."""
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
    tables: dict[str, type[Table]] = {"robot": RobotTable, "limits": LimitsTable}
    tables |= {"workspace": WorkspaceTable, "sensor": SensorTable}
    table = tables.get(str(location[0]), RigTable) if len(location) > 1 else RigTable
    return ", ".join(table.model_fields)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
