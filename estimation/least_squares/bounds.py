"""Bounds: stated intervals of parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf, isnan
from pathlib import Path
from typing import Self

from modeling.errors import InputError, file_text, kind_of, quoted, suggestion, toml_data


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


def require_known_names(names: Iterable[str], allowed: Iterable[str], where: str) -> None:
    """Raise InputError for the first unknown name, suggesting the closest known one."""
    allowed = list(allowed)
    for name in names:
        if name not in allowed:
            raise InputError(
                what=f"no parameter is called {quoted(name)}",
                where=where,
                remedy=suggestion(name, allowed, most=len(allowed)),
            )


BOUNDS_REMEDY = (
    "write name = [low, high], in the parameter's SI unit; inf leaves a side unbounded, one number alone fixes it"
)

Interval = float | tuple[float, float]
"""Lower and upper bound; a number fixes the parameter."""


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bound of parameters by name, inclusive.

    `read` takes them from a TOML file, `from_data` from a dictionary of its layout; both check the intervals.

    Parameters
    ----------
    intervals : mapping of str to (float, float) or float
        Lower and upper bound in the parameter's unit, infinite for none; equal bounds fix a parameter, and so does a
        number. With several recordings `bias_fx` is the first one's, `bias_fx@name` another's.
    where : str, optional
        Their source in an InputError, by default "bounds".

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> bounds = tw.Bounds({"m": (0.0, 0.9), "I": (0.0, float("inf"))})
    >>> fit = tw.fit(
    ...     tw.planar(rig), tw.read("train.csv", rig=rig), constraints=tw.Constraints(bounds=bounds)
    ... )
    >>> round(fit.values["m"], 6)
    0.9
    """

    intervals: Mapping[str, Interval]
    where: str = "bounds"

    def __post_init__(self) -> None:
        given: object = self.intervals  # whatever the caller's types say
        if not isinstance(given, Mapping):
            what = f"{kind_of(given)} has no intervals by parameter name"
            raise InputError(what=what, where=self.where, remedy='give {"m": (0.1, 3.0)}, or {"m": 0.9} to fix it')
        _ = self.ends

    @cached_property
    def ends(self) -> Mapping[str, tuple[float, float]]:
        """Lower and upper bound by name; InputError for what is no interval."""
        return {str(name): _ends(name, value, self.where) for name, value in self.intervals.items()}

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The bounds of a TOML file: `m = [0.1, 3.0]`, `m = 0.9`, `"viscous_drag.c" = [0, inf]`.

        Raises InputError, in one line with file and key, for an invalid interval.
        """
        return cls.from_data(read_parameter_file(path), where=str(path))

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "bounds") -> Self:
        """The bounds of a plain dictionary with the file's layout."""
        return cls({name: _ends(name, value, where) for name, value in data.items()}, where)


def _ends(name: str, value: object, where: str) -> tuple[float, float]:
    if is_real_number(value):
        value = (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(is_real_number, value)):
        text = repr(value)
        given = text if len(text) <= 60 else text[:57] + "..."
        raise InputError(
            what=f"{name}: one or two numbers were expected, and {given} came", where=where, remedy=BOUNDS_REMEDY
        )
    low, high = map(float, value)
    if low > high or low == inf or high == -inf:
        raise InputError(
            what=f"{name}: [{low:g}, {high:g}] contains no finite value", where=where, remedy=BOUNDS_REMEDY
        )
    return low, high
