"""Description: dataclasses of this package as plain data that says all that they are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

PACKAGE = "modeling."


def described(thing: object) -> Any:
    """Lists, numbers and texts that are equal for equal things, and differ for others.

    Raises TypeError for what is not of this package, whose derivations may follow from more than its data.
    """
    match thing:
        case None | bool() | int() | str():
            return thing
        case float():
            return float(thing)
        case tuple() | list():
            return [described(part) for part in thing]
        case Mapping():
            return {"mapping": sorted([described(key), described(value)] for key, value in thing.items())}
    kind = type(thing)
    name = f"{kind.__module__}.{kind.__qualname__}"
    if not name.startswith(PACKAGE) or "<locals>" in name:
        raise TypeError(f"{name} cannot be described")
    if isinstance(thing, Enum):
        return [name, thing.name]
    if is_dataclass(thing):
        return [name, *([field.name, described(getattr(thing, field.name))] for field in fields(thing))]
    raise TypeError(f"{name} cannot be described")
