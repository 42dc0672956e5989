"""Schema of a rig's TOML file, and its errors in one line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from modeling.errors import InputError, quoted, suggestion
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import LARGEST_NUMBER, SMALLEST_NUMBER, is_possible, unit_direction
from modeling.space import Space

Location = tuple[int | str, ...]


class StrictTable(BaseModel):
    """A table of a file: no other keys, no type coercion, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


Schema = TypeVar("Schema", bound=StrictTable)


def validated(schema: type[Schema], data: object, where: str, remedy: str = "correct it there") -> Schema:
    """The table of plain data; InputError, naming the key, for data that do not conform to the schema."""
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise _first_error(schema, error, where, remedy) from None


def _first_error(schema: type[StrictTable], error: ValidationError, where: str, remedy: str) -> InputError:
    first = error.errors(include_url=False, include_context=False)[0]
    what = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        what, remedy = "no such key", suggestion(str(first["loc"][-1]), _fields(schema, first["loc"]))
    elif first["type"] == "missing":
        what, remedy = "missing", "add it there"
    elif "got " not in what:
        what = f"{what}, got {quoted(first['input'])}"
    key = _key(first["loc"])
    return InputError(what=f"{key}: {what}" if key else what, where=where, remedy=remedy)


BRANCHES = ("limits by joint", "by the URDF")
"""Kinds of an entry of which pydantic names one in the place of an error: they are no keys."""


def _key(location: Location) -> str:
    """The place of a value, as in limits.position[0]."""
    key = ""
    for step in location:
        if step in BRANCHES:
            continue
        name = step if isinstance(step, int) or step.isidentifier() else quoted(step)
        key += f"[{name}]" if isinstance(step, int) else f".{name}"
    return key.lstrip(".").removesuffix(".[key]")


def _fields(schema: Any, location: Location) -> list[str]:
    """The keys of the innermost table that a location passes through."""
    for step in location[:-1]:
        field = schema.model_fields.get(step)
        schema = _table_in(field.annotation) or schema if field else schema
    return [*schema.model_fields]


def _table_in(annotation: Any) -> Any:
    """The schema within an annotation such as `LimitsTable | None`, if it has one."""
    if isinstance(annotation, type) and issubclass(annotation, StrictTable):
        return annotation
    return next(filter(None, map(_table_in, get_args(annotation))), None)


SPATIAL_ARM = TypeAdapter(SpatialArm)
LARGEST_GRAVITY = 100.0
"""m/s²: that of Jupiter is 25, and 9806 is in mm/s²."""


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_NUMBER


def symmetric_limits(value: object) -> object:
    """A symmetric limit or [low, high] as (low, high)."""
    if _number(value) and float(value) > 0:  # type: ignore[arg-type]
        return (-float(value), float(value))  # type: ignore[arg-type]
    return _interval(value)


def _interval(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) == 2 and all(map(_number, value)) and value[0] < value[1]:
        return (float(value[0]), float(value[1]))
    raise ValueError("expected a positive number, or [low, high] with low below high")


def _span(value: object) -> object:
    if _number(value):
        raise ValueError("expected [low, high] with low below high")
    return _interval(value)


def _direction(components: list[float]) -> list[float]:
    return list(unit_direction(components))


def _normal(components: list[float]) -> list[float]:
    if len(components) != 3 or not any(components):
        raise ValueError(f"expected a normal such as [0, 0, 1], got {components}")
    return components


def _inertia(moments: list[float]) -> list[float]:
    if not is_possible(moments):
        raise ValueError(f"expected Ixx, Ixy, Ixz, Iyy, Iyz, Izz of a body about its centre, got {moments}")
    return moments


def _not_negative(value: float) -> float:
    if not 0 <= value < LARGEST_NUMBER:
        raise ValueError(f"expected zero or a positive number of m, got {value}")
    return value


def _gravity(value: float) -> float:
    if not SMALLEST_NUMBER < value <= LARGEST_GRAVITY:
        raise ValueError(f"expected m/s², above 0 and up to {LARGEST_GRAVITY:g}, as 9.806 on Earth")
    return value


def _positive(value: float) -> float:
    if not SMALLEST_NUMBER < value < LARGEST_NUMBER:
        raise ValueError(f"expected a number above 0, of {SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g}")
    return value


Coordinate = Annotated[float, Field(gt=-LARGEST_NUMBER, lt=LARGEST_NUMBER)]
Point = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
PositiveNumber = Annotated[float, AfterValidator(_positive)]
LimitPair = Annotated[tuple[float, float], BeforeValidator(symmetric_limits)]
LimitPairs = Annotated[list[LimitPair], Field(min_length=1)]
LimitInterval = Annotated[tuple[float, float], BeforeValidator(_span)]
TorqueEntry = Annotated[
    Annotated[LimitPairs, Tag(BRANCHES[0])] | Annotated[Literal["urdf"], Tag(BRANCHES[1])],
    Discriminator(lambda value: BRANCHES[isinstance(value, str)]),
]
Joints = Annotated[list[Coordinate], Field(min_length=1)]
Resistances = Annotated[list[Annotated[float, Field(ge=0, lt=LARGEST_NUMBER)]], Field(min_length=1)]
Channel = Literal["fx", "fy", "fz", "tx", "ty", "tz", "tau"]
PerChannel = Annotated[dict[Channel, PositiveNumber], Field(min_length=1)]


class RobotTable(StrictTable):
    """[robot]; `spatial_arm` is the arm of the URDF, in a rig stored without that file."""

    name: str = ""
    link_lengths: Annotated[list[PositiveNumber], Field(min_length=1)] | None = None
    urdf: str | None = None
    sensor_frame: str | None = None
    spatial_arm: Annotated[SpatialArm, BeforeValidator(SPATIAL_ARM.validate_python)] | None = None
    tip_length: PositiveNumber | None = None
    gravity: Annotated[float, AfterValidator(_gravity)] | None = None
    gravity_direction: Annotated[list[float], AfterValidator(_direction)] | None = None

    @model_validator(mode="after")
    def _one_description(self) -> Self:
        if self.link_lengths is not None and (self.urdf is not None or self.spatial_arm is not None):
            raise ValueError("expected link_lengths or urdf, got both")
        axes = {2} if self.link_lengths is not None else {3} if self.urdf is not None else {2, 3}
        if self.gravity_direction is not None and len(self.gravity_direction) not in axes:
            expected = f"expected gravity_direction along {min(axes)} axes of this arm's base"
            raise ValueError(f"{expected}, got {len(self.gravity_direction)} numbers")
        return self


class LimitsTable(StrictTable):
    """[limits], in rad, rad/s, rad/s², rad/s³, m for prismatic joints; what is missing may be in a URDF.

    torque in N m, N for prismatic joints, or "urdf": its effort; start and end are joint coordinates.
    """

    position: LimitPairs | None = None
    velocity: LimitPairs | None = None
    acceleration: LimitPairs | None = None
    jerk: LimitPairs | None = None
    torque: TorqueEntry | None = None
    start: Joints | None = None
    end: Joints | None = None

    @model_validator(mode="after")
    def _same_joints(self) -> Self:
        if len(set(self.counts.values())) > 1:
            raise ValueError(f"expected as many numbers in each list as joints, got {self.counts}")
        return self

    @property
    def counts(self) -> dict[str, int]:
        """Number of joints of each list."""
        return {name: len(pairs) for name, pairs in self if isinstance(pairs, list)}


class WorkspaceTable(StrictTable):
    """[workspace], in m; capsules = "urdf": around the collision geometry of its links."""

    x: LimitInterval | None = None
    y: LimitInterval | None = None
    z: LimitInterval | None = None
    clearance: Annotated[float, AfterValidator(_not_negative)] = 0.0
    capsules: Literal["urdf"] | None = None


class CapsuleTable(StrictTable):
    """[[capsule]], in m: of a link of the URDF, of so many joints, or, with neither, fixed in the world."""

    name: str = ""
    link: str | None = None
    joint: Annotated[int, Field(ge=0)] | None = None
    start: Point
    end: Point | None = None
    radius: PositiveNumber

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.link is not None and self.joint is not None:
            raise ValueError("expected link or joint, got both")
        return self


class BodyTable(StrictTable):
    """[[body]], of a link of the URDF or of so many joints, in kg, m and, about the centre, kg m²."""

    link: str | None = None
    joint: Annotated[int, Field(ge=1)] | None = None
    mass: PositiveNumber
    centre: Point = [0.0, 0.0, 0.0]
    inertia: Annotated[list[Coordinate], Field(min_length=6, max_length=6), AfterValidator(_inertia)] = [0.0] * 6

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.link is None) == (self.joint is None):
            raise ValueError(f"expected link or joint, got {'both' if self.link else 'neither'}")
        return self


class LoadTable(StrictTable):
    """[[load]]: what recordings of these names carried beside the tool, in kg, m and, about the centre, kg m²."""

    recording: str | list[str]
    name: str = ""
    mass: PositiveNumber | None = None
    at: Annotated[list[Coordinate], Field(max_length=3)] = []
    inertia: Annotated[list[Coordinate], Field(max_length=6)] = []
    mass_std: Annotated[float, AfterValidator(_not_negative)] = 0.0
    at_std: Annotated[float, AfterValidator(_not_negative)] = 0.0

    @model_validator(mode="after")
    def _is_of_something(self) -> Self:
        if self.mass is None and not self.name:
            raise ValueError("expected a mass, or the name of a body of unknown mass, got neither")
        if len(self.inertia) == 6:
            _inertia(self.inertia)
        return self


class FrictionTable(StrictTable):
    """[friction] of the joints, in N m s/rad and N m, or N s/m and N."""

    viscous: Resistances | None = None
    coulomb: Resistances | None = None


class HalfSpaceTable(StrictTable):
    """[[half_space]], in m."""

    normal: Annotated[list[Coordinate], AfterValidator(_normal)]
    offset: Coordinate
    clearance: Annotated[float, AfterValidator(_not_negative)] = 0.0


class SensorTable(StrictTable):
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
            raise ValueError(f"expected channels of a planar or of a six-axis sensor, got {sorted(named)}")
        return self


class RigTable(StrictTable):
    """The whole file."""

    robot: RobotTable = RobotTable()
    limits: LimitsTable | None = None
    workspace: WorkspaceTable | None = None
    capsule: list[CapsuleTable] = []
    half_space: list[HalfSpaceTable] = []
    body: list[BodyTable] = []
    load: list[LoadTable] = []
    friction: FrictionTable | None = None
    sensor: SensorTable = SensorTable()
    columns: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _limits_fit_the_arm(self) -> Self:
        lengths, limits = self.robot.link_lengths, self.limits
        if lengths is not None and limits is not None and {len(lengths)} != {*limits.counts.values(), len(lengths)}:
            counts = f"got {len(lengths)} link_lengths and {min(limits.counts.values())} limits"
            raise ValueError(f"expected limits for each joint of robot.link_lengths, {counts}")
        return self


def validated_tables(data: Mapping[str, object], where: str) -> dict[str, Any]:
    """The validated tables as plain data, missing entries as None; InputError for anything else."""
    return validated(RigTable, dict(data), where).model_dump(mode="json")
