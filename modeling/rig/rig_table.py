"""Table of a rig: what its file states, by the names of the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from modeling.table import Table

UNITS = {"link_lengths": "m", "tip_length": "m", "gravity": "m/s²", "x": "m", "y": "m", "z": "m"}
RATES = {"position": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}
CHANNELS = ("noise", "range", "tolerance")
"""Entries with a number for each channel, N or N m."""


def rig_table(data: Mapping[str, Any], joint_unit: str = "rad") -> Table:
    """Of the rig's plain data; an arm that was read from a URDF is the URDF's name."""
    rows = [
        (name, _text(value), _unit(name.rpartition(".")[2], joint_unit))
        for name, value in _entries(data)
        if name != "robot.name" and value not in (False, "")
    ]
    return Table.of(("stated", "value", "unit"), rows)


def _entries(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for section, table in data.items():
        for key, value in table.items():
            if key != "spatial_arm":
                yield f"{section}.{key}", value


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(part)}" for name, part in value.items())
    if isinstance(value, list):
        inner = ", ".join(_text(part) for part in value)
        return f"[{inner}]" if value and not isinstance(value[0], list) else inner
    return f"{value:g}" if isinstance(value, float) else str(value)


def _unit(key: str, joint_unit: str) -> str:
    if key in RATES:
        return " or ".join(unit + RATES[key] for unit in joint_unit.split(" or "))
    return "N, N m" if key in CHANNELS else UNITS.get(key, "")
