"""Units in which logs are written, and their factors to SI."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import pi

LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
ANGLE = {"rad": 1.0, "deg": pi / 180, "°": pi / 180, "mrad": 1e-3}
TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
FORCE = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605}
TORQUE = {"nm": 1.0, "nmm": 1e-3, "mnm": 1e-3, "ncm": 1e-2, "lbf.in": 0.1129848290276167}
KINDS: Mapping[str, Mapping[str, float]] = {
    "time": TIME, "position": LENGTH, "angle": ANGLE, "force": FORCE, "torque": TORQUE,
}  # fmt: skip
"""Factors to s, m, rad, N, N m by the unit in lower case, blanks, points and stars left out."""

IN_BRACKETS = re.compile(r"^(?P<name>.*?)[\s_]*[\[(]\s*(?P<unit>[^\])\d]+)\s*[\])]$")
AT_END = re.compile(r"^(?P<name>.*[a-z0-9\])])_(?P<unit>s|sec|ms|us|ns|n|nm|nmm|m|mm|cm|rad|deg)$", re.IGNORECASE)


def plain_unit(text: str) -> str:
    """The unit in lower case without blanks, points and stars: `N m`, `N*m` and `N.m` are `nm`."""
    return re.sub(r"[\s.*·⋅]", "", text.strip().lower())


def name_and_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit where the name ends in one that is known: `Fx (N)`, `time_ms`."""
    known = {unit for kind in KINDS.values() for unit in kind}
    for pattern in (IN_BRACKETS, AT_END):
        found = pattern.match(name.strip())
        if found and plain_unit(found["unit"]) in known:
            return found["name"].strip(), plain_unit(found["unit"])
    return name.strip(), None
