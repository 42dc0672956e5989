"""Column map: which columns are what, and their units, stated in TOML by --map or [columns] of the rig."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Self

from estimation.reading.orientation_form import OrientationForm
from modeling.errors import InputError, quoted, suggestion
from modeling.rig import SPATIAL_CHANNELS

# Units in which logs are written, and their factors to SI.


LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
ANGLE = {"rad": 1.0, "deg": pi / 180, "°": pi / 180, "mrad": 1e-3}
TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
KILOPOND = 9.80665
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": KILOPOND, "gf": 1e-3 * KILOPOND, "lbf": 4.4482216152605}
FORCE |= {"ozf": FORCE["lbf"] / 16}
TORQUE = {
    f"{force} {length}": FORCE[force] * LENGTH[length]
    for force, length in (
        ("N", "m"), ("N", "mm"), ("N", "cm"), ("mN", "m"), ("kN", "m"), ("kgf", "m"), ("kgf", "cm"), ("kgf", "mm"),
        ("gf", "cm"), ("lbf", "in"), ("lbf", "ft"), ("ozf", "in"),
    )
}  # fmt: skip
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": TIME, "position": LENGTH, "angle": ANGLE, "force": FORCE, "torque": TORQUE,
    "acceleration": {"m/s²": 1.0, "g": KILOPOND, "mg": 1e-3 * KILOPOND},
    "rate": {"rad/s": 1.0, "deg/s": pi / 180},
}  # fmt: skip
"""Factors to s, m, rad, N, N m, m/s², rad/s by the unit, as it is called in a message."""
OTHER_SPELLINGS: Mapping[str, tuple[str, ...]] = {
    "s": ("secs", "second", "seconds"), "ms": ("msec", "msecs", "millis", "milliseconds"), "us": ("usec", "usecs"),
    "ns": ("nsec", "nsecs", "nanoseconds"), "deg": ("degs", "degree", "degrees"), "rad": ("rads", "radian", "radians"),
    "m": ("metre", "metres", "meter", "meters"), "mm": ("millimetres", "millimeters"), "in": ("inch", "inches"),
    "ft": ("foot", "feet"), "N": ("newton", "newtons"), "m/s²": ("m/s^2", "m/s2", "m/s/s", "ms2", "mps2"),
    "rad/s": ("rads", "rad/sec", "radps"), "deg/s": ("degs", "°/s", "deg/sec", "dps"),
}  # fmt: skip
"""Further ones of a unit, within its kind."""
FORCE_NAMES: Mapping[str, tuple[str, ...]] = {
    "lbf": ("lbf", "lb", "lbs", "pound"), "ozf": ("ozf", "oz"), "kgf": ("kgf", "kg", "kp"), "gf": ("gf", "g")
}  # fmt: skip
"""How forces are called that are weights: mostly as masses."""

BRACKETED = re.compile(r"(?P<name>.+?)[\s_]*(?:\[(?P<a>[^\]]+)\]|\((?P<b>[^)]+)\)|\{(?P<c>[^}]+)\}|<(?P<d>[^>]+)>)\s*")
SET_APART = re.compile(r"(?P<name>[^/,]*[^/,\s])\s*[/,]\s*(?P<unit>[^/,]+(?:/s.*)?)")
"""A unit in brackets, and one after a stroke or a comma; the path of a topic has more strokes."""
UNSAFE_AT_END = {"g", "in", "ft", "foot", "second"}
"""Units that a name ends in by chance, as `wrench_ft` and `fx_second` do, and that are read in brackets alone."""


def plain_unit(text: str) -> str:
    """The unit in lower case without what joins factors: `N m`, `N*m`, `N.m` and `N-m` are `nm`."""
    return re.sub(r"[\s.*·⋅×_\-‐‑–−]", "", text.strip().lower()).replace("μ", "µ")


def _spellings(unit: str) -> set[str]:
    """How a unit is written: of pounds and kiloponds with the arm first, too; a metre-newton would be the mN."""
    force, *arm = unit.split()
    called = FORCE_NAMES.get(force, (force,))
    orders = [[name, *arm] for name in called] + [[*arm, name] for name in called if force in FORCE_NAMES]
    return {plain_unit(" ".join(order)) for order in orders} | set(OTHER_SPELLINGS.get(unit, ()))


KINDS: Mapping[str, Mapping[str, float]] = {
    kind: {spelling: factor for unit, factor in units.items() for spelling in _spellings(unit)}
    for kind, units in UNITS.items()
}
"""Factors to SI by the unit as `plain_unit` has it, in any of its spellings."""
PARTED = {unit for kind in ("torque", "acceleration", "rate") for unit in KINDS[kind]}
"""Units that may be written as several words: `lbf_in`, `rad_s`."""
KNOWN = {unit for kind in KINDS.values() for unit in kind}


def name_and_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit where the name ends in one that is known: `Fx (N)`, `time_ms`."""
    name = name.strip()
    if match := BRACKETED.fullmatch(name):
        unit = plain_unit(next(filter(None, match.group("a", "b", "c", "d"))))
        if unit in KNOWN:
            return match["name"], unit
    if (match := SET_APART.fullmatch(name)) and plain_unit(match["unit"]) in KNOWN:
        return match["name"], plain_unit(match["unit"])
    words = re.split(r"([_\s]+)", name)
    for count in (3, 2, 1):  # words of the unit: the longest that is one
        start = len(words) - 2 * count + 1
        unit, rest = plain_unit("".join(words[start:])), "".join(words[: start - 1])
        is_unit = unit in (KNOWN - UNSAFE_AT_END if count == 1 else PARTED)
        if start > 0 and is_unit and re.search(r"[a-z0-9\])]$", rest, re.IGNORECASE):
            return rest, unit
    return name, None


VECTORS: Mapping[str, tuple[str, ...]] = {
    "wrench": SPATIAL_CHANNELS,
    "planar_wrench": ("fx", "fy", "tau"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "position": ("px", "py", "pz"),
    "angular_velocity": ("wx", "wy", "wz"),
}
"""Columns by name that together are one vector; a map may give them one by one, as one list, or as the name of the
topic, sheet or file that has them."""
OPTIONS = ("orientation", "orientation_columns", "orientation_of", "joints", "units", "wrench_axes", "rate", "offset")
LARGEST_STATED = 1e9
"""Beyond any rate in Hz and any offset in s; stamps since 1970 are 1.8e9 s."""
REMEDY = 'write names as keys and columns as values, such as fx = "wrench.force.x"'


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """A map as its author wrote it.

    columns  source columns by name: time, fx .. tz, qx .. qw, px .. pz, q1 .., and any auxiliary signal
    tables   topic, sheet or file by the name of the vector that is to be taken from it
    units    factors to SI by kind (time, position, angle, force, torque); `epoch` leaves the time in seconds
    inverse  whether the orientation is that of the base in the sensor (orientation_of = "base"), not the other way
    axes     "sensor" or "base": along which the wrench is given; rate in Hz of sources without time
    offset   wrench stamp minus motion stamp of the same instant, s; None to estimate it
    """

    where: str = "map"
    columns: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)
    orientation: tuple[str, ...] = ()
    form: OrientationForm | None = None
    inverse: bool = False
    units: Mapping[str, float] = field(default_factory=dict)
    axes: str | None = None
    rate: float | None = None
    offset: float | None = None

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The map of a TOML file, at its top or under [columns]; InputError where it cannot be one."""
        try:
            data = tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
        except OSError as error:
            raise InputError(
                what=error.strerror or "cannot be read", where=str(path), remedy="give the path of a map"
            ) from None
        except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(
                what=f"not a TOML file: {error}", where=str(path), remedy="correct the TOML there"
            ) from None
        inner = data.pop("columns", {})
        if not isinstance(inner, dict):
            raise InputError(what="columns is not a table", where=str(path), remedy=REMEDY)
        return cls.of({**data, **inner}, str(path))

    @classmethod
    def of(cls, data: Mapping[str, object], where: str = "map") -> Self:
        """The map of a dictionary with the structure of the TOML file."""
        given = _Checked(data, where)
        for key, value in data.items():
            if isinstance(value, list) and key not in OPTIONS and key not in VECTORS:
                remedy = suggestion(key, [*VECTORS, "joints", "orientation_columns"])
                raise InputError(what=f"{quoted(key)} is no name of a list of columns", where=where, remedy=remedy)
        columns = {key: given.text(key) for key in data if key not in OPTIONS and key not in VECTORS}
        tables = {key: given.text(key) for key in VECTORS if isinstance(data.get(key), str)}
        for key, names in VECTORS.items():
            if key in data and key not in tables:
                columns |= dict(zip(names, given.texts(key, (len(names),)), strict=True))
        if "joints" in data:
            columns |= {f"q{i}": column for i, column in enumerate(given.texts("joints", None), 1)}
        form = OrientationForm.parsed(given.text("orientation"), where) if "orientation" in data else None
        orientation = tuple(columns.pop(name) for name in VECTORS["quaternion"] if name in columns)
        form = OrientationForm("xyzw") if orientation and form is None else form  # qx .. qw state the order
        if "orientation_columns" in data:
            orientation = tuple(given.texts("orientation_columns", (3, 4, 9, 12, 16)))
        if orientation and len(orientation) not in (form or OrientationForm("xyzw")).columns:
            what = f"{len(orientation)} columns of orientation are no {form or 'quaternion x y z w'}"
            raise InputError(what=what, where=where, remedy='state their form, such as orientation = "rotation_vector"')
        return cls(
            where=where, columns=columns, tables=tables, orientation=orientation, form=form, units=given.units(),
            axes=given.frame("wrench_axes"), inverse=given.frame("orientation_of") == "base",
            rate=given.number("rate", low=0.0), offset=given.number("offset"),
        )  # fmt: skip

    def factor(self, kind: str) -> float | None:
        """The stated factor to SI of a kind of unit."""
        return self.units.get(kind)


@dataclass(frozen=True)
class _Checked:
    """The entries of a map, checked as they are taken."""

    data: Mapping[str, object]
    where: str

    def error(self, what: str, remedy: str = REMEDY) -> InputError:
        return InputError(what=what, where=self.where, remedy=remedy)

    def text(self, key: str) -> str:
        value = self.data[key]
        if not isinstance(value, str) or not value.strip():
            raise self.error(f"{quoted(key)} is {quoted(value)}, not the name of a column")
        return value

    def frame(self, key: str) -> str | None:
        text = self.text(key) if key in self.data else None
        if text not in (None, "sensor", "base"):
            raise self.error(f"{key} = {quoted(text)}", 'use "sensor" or "base"')
        return text

    def texts(self, key: str, lengths: tuple[int, ...] | None) -> list[str]:
        value = self.data[key]
        if not isinstance(value, list) or not value or not all(isinstance(name, str) for name in value):
            raise self.error(f"{quoted(key)} is no list of columns")
        if lengths is not None and len(value) not in lengths:
            raise self.error(f"{quoted(key)} has {len(value)} columns", f"give {' or '.join(map(str, lengths))}")
        return value

    def number(self, key: str, low: float | None = None) -> float | None:
        value = self.data.get(key)
        if value is None:
            return None
        if (
            not isinstance(value, int | float)
            or isinstance(value, bool)
            or not abs(value) < LARGEST_STATED
            or (low is not None and value <= low)
        ):
            raise self.error(f"{quoted(key)} is {quoted(value)}, not a number that it can be", "give a number")
        return float(value)

    def units(self) -> dict[str, float]:
        units = self.data.get("units", {})
        if not isinstance(units, dict):
            raise self.error("units is not a table", 'write units = { time = "ms", position = "mm", angle = "deg" }')
        factors = {}
        for kind, unit in units.items():
            spellings = KINDS.get(kind)
            if spellings is None:
                raise self.error(f"units.{quoted(kind)} is no kind of unit", f"use one of {', '.join(KINDS)}")
            plain = plain_unit(re.sub("^epoch(_in)?_?|^epoch$", "", str(unit))) or "s"
            if plain not in spellings:
                raise self.error(f"units.{kind} = {quoted(unit)} is not known", f"use one of {', '.join(UNITS[kind])}")
            factors[kind] = spellings[plain]
        return factors
