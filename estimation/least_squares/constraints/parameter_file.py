"""Numbers by parameter name from TOML, and the check of parameter names."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from math import isnan
from pathlib import Path

from modeling.errors import InputError


def read_parameter_file(path: str | Path) -> dict[str, object]:
    """The entries of a TOML file by name; `viscous_drag.c`, quoted or as a table, is one name.

    Raises InputError, in one line, when it cannot be read or is not TOML.
    """
    where, remedy = str(path), "give the path of a TOML file"
    try:
        data = tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise InputError(what=error.strerror or "cannot be read", where=where, remedy=remedy) from None
    except ValueError as error:  # invalid TOML or UTF-8, or an impossible path
        raise InputError(
            what=f"not a TOML file: {error}", where=where, remedy="correct the TOML syntax there"
        ) from None
    entries: dict[str, object] = {}
    for name, value in _entries(data):
        if name in entries:
            raise InputError(what=f"'{name}' appears twice", where=where, remedy="name each parameter once")
        entries[name] = value
    return entries


def _entries(table: Mapping[str, object], above: str = "") -> Iterator[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _entries(value, f"{above}{key}.")
        else:
            yield above + key, value


def is_real_number(value: object) -> bool:
    """Whether it is a real number; infinity is, NaN and booleans are not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and not isnan(value)


def require_known_names(names: Iterable[str], known: Iterable[str], where: str) -> None:
    """Raise InputError for the first unknown name, suggesting the closest known one."""
    known = list(known)
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            remedy = f"did you mean '{near[0]}'?" if near else f"the parameters are {', '.join(known)}"
            raise InputError(what=f"no parameter is called '{name[:60]}'", where=where, remedy=remedy)
