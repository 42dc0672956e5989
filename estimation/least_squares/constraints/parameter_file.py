"""Numbers by parameter name from TOML, and the check of parameter names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import isnan
from pathlib import Path

from modeling.errors import InputError, quoted, suggestion
from modeling.text_file import file_text, toml_data


def read_parameter_file(path: str | Path) -> dict[str, object]:
    """The entries of a TOML file by name; `viscous_drag.c`, quoted or as a table, is one name.

    Raises InputError, in one line, when it cannot be read or is not TOML.
    """
    where = str(path)
    entries: dict[str, object] = {}
    for name, value in _entries(toml_data(file_text(path, kind="a TOML file"), where)):
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
            raise InputError(
                what=f"no parameter is called {quoted(name)}",
                where=where,
                remedy=suggestion(name, known, most=len(known)),
            )
