"""Base of the schemas of users' tables, and their errors in one line."""

from __future__ import annotations

from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from modeling.errors import InputError, quoted, suggestion

Location = tuple[int | str, ...]


class StrictTable(BaseModel):
    """A table of a file: no other keys, no type coercion, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


Table = TypeVar("Table", bound=StrictTable)


def validated(schema: type[Table], data: object, where: str, remedy: str = "correct it there") -> Table:
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


def _key(location: Location) -> str:
    """The place of a value, as in limits.position[0]."""
    key = ""
    for part in location:
        name = part if isinstance(part, int) or part.isidentifier() else quoted(part)
        key += f"[{name}]" if isinstance(part, int) else f".{name}"
    return key.lstrip(".").removesuffix(".[key]")


def _fields(schema: Any, location: Location) -> list[str]:
    """The keys of the innermost table that a location passes through."""
    for part in location[:-1]:
        field = schema.model_fields.get(part)
        schema = _table_in(field.annotation) or schema if field else schema
    return [*schema.model_fields]


def _table_in(annotation: Any) -> Any:
    """The schema within an annotation such as `LimitsTable | None`, if it has one."""
    if isinstance(annotation, type) and issubclass(annotation, StrictTable):
        return annotation
    return next(filter(None, map(_table_in, get_args(annotation))), None)
