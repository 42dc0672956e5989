"""Bounds: intervals in which somebody knows parameters to lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Self

from estimation.constrained.named_numbers import is_number, read_named
from modeling.errors import InputError

REMEDY = "write name = [low, high], in the parameter's SI unit; inf leaves a side open"


@dataclass(frozen=True)
class Bounds:
    """Lowest and highest value of parameters by name, inclusive, in the parameters' units.

    Equal ends fix a parameter. With several recordings `bias_fx` is the first one's, `bias_fx@name` another's.
    `where` names their source in an InputError.
    """

    intervals: Mapping[str, tuple[float, float]]
    where: str = "bounds"

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The bounds of a TOML file: `m = [0.1, 3.0]`, `"viscous_drag.c" = [0, inf]`.

        Raises InputError, in one line with file and key, for whatever is no interval.
        """
        return cls.from_data(read_named(path), where=str(path))

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "bounds") -> Self:
        """The bounds of a plain dictionary laid out as the file."""
        return cls({name: _interval(name, value, where) for name, value in data.items()}, where)


def _interval(name: str, value: object, where: str) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(is_number, value)):
        shown = repr(value)
        came = shown if len(shown) <= 60 else shown[:57] + "..."
        raise InputError(what=f"{name}: two numbers were expected, and {came} came", where=where, remedy=REMEDY)
    low, high = map(float, value)
    if low > high or low == inf or high == -inf:
        raise InputError(what=f"{name}: [{low:g}, {high:g}] holds no number", where=where, remedy=REMEDY)
    return low, high
