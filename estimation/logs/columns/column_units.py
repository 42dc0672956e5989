"""Units in which logs are written, and their factors to SI."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import pi

LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
ANGLE = {"rad": 1.0, "deg": pi / 180, "°": pi / 180, "mrad": 1e-3}
TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605}
TORQUE = {
    f"{force} {length}": FORCE[force] * LENGTH[length]
    for force, length in (
        ("N", "m"), ("N", "mm"), ("N", "cm"), ("mN", "m"), ("kN", "m"), ("kgf", "m"), ("kgf", "cm"), ("lbf", "in"),
        ("lbf", "ft"),
    )
}  # fmt: skip
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": TIME, "position": LENGTH, "angle": ANGLE, "force": FORCE, "torque": TORQUE,
}  # fmt: skip
"""Factors to s, m, rad, N, N m by the unit, as it is called in a message."""
POUND = re.compile(r"\blbf\b")

IN_BRACKETS = re.compile(r"^(?P<name>.*?)[\s_]*[\[(]\s*(?P<unit>[^\])\d]+)\s*[\])]$")
AT_END = re.compile(
    r"^(?P<name>.*[a-z0-9\])])_(?P<unit>s|sec|ms|us|ns|n|nm|nmm|m|mm|cm|rad|deg|kgf|lbf|lbf_?(?:in|ft))$", re.IGNORECASE
)


def plain_unit(text: str) -> str:
    """The unit in lower case without what joins factors: `N m`, `N*m`, `N.m` and `N-m` are `nm`."""
    return re.sub(r"[\s.*·⋅×_\-‐‑–−]", "", text.strip().lower()).replace("μ", "µ")


def _spellings(unit: str) -> set[str]:
    """How a unit is written: of pounds and kiloponds with the arm first, too; a metre-newton would be the mN."""
    orders = {unit, " ".join(reversed(unit.split()))} if "f" in unit.split()[0] else {unit}
    return {plain_unit(text) for order in orders for text in (order, POUND.sub("lb", order), POUND.sub("lbs", order))}


KINDS: Mapping[str, Mapping[str, float]] = {
    kind: {spelling: factor for unit, factor in units.items() for spelling in _spellings(unit)}
    for kind, units in UNITS.items()
}
"""Factors to s, m, rad, N, N m by the unit as `plain_unit` has it, in any of its spellings."""


def name_and_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit where the name ends in one that is known: `Fx (N)`, `time_ms`."""
    known = {unit for kind in KINDS.values() for unit in kind}
    for pattern in (IN_BRACKETS, AT_END):
        found = pattern.match(name.strip())
        if found and plain_unit(found["unit"]) in known:
            return found["name"].strip(), plain_unit(found["unit"])
    return name.strip(), None
