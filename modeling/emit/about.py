"""About: what somebody who reads emitted code has to know, in lines of plain text."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap

from modeling.emit.base import BaseRegressor
from modeling.emit.text import comment
from modeling.parameter import Parameter
from modeling.space import Space

WIDTH = 100
"""Characters of a line of emitted comment."""

PLANAR_FRAMES = (
    "World: x right, y up, gravity (0, -9.806) m/s2. phi (rad) is the angle of the tip, clockwise from +y; (ax, ay)"
    " the acceleration of the sensor origin in the world (m/s2), gravity excluded; dphi, ddphi in rad/s, rad/s2.",
    "Signs of equation 22.8: the wrench that the sensor exerts on the tool, in the axes x' = (cos phi, -sin phi) and"
    " -y', y' = (sin phi, cos phi) along the tip, torque clockwise about the sensor origin.",
)
SPATIAL_FRAMES = (
    "All vectors in the sensor frame: a is the acceleration of the sensor origin minus gravity (m/s2), omega the"
    " angular velocity (rad/s), alpha the angular acceleration (rad/s2).",
    "Convention on_tool: the wrench that the sensor exerts on the tool, F = m a + .., torque about the sensor origin.",
)


def about_regressor(base: BaseRegressor) -> list[str]:
    """Frames, signs, units and the order of everything, a paragraph each."""
    title = "planar" if base.space is Space.PLANE else "six-axis"
    return [
        f"Regressor of the {title} rigid tool on a wrist force/torque sensor: reading = regressor * parameters.",
        *(PLANAR_FRAMES if base.space is Space.PLANE else SPATIAL_FRAMES),
        f"Inputs in order: {', '.join(base.inputs)}.",
        f"Rows: {with_units(zip(base.space.channels, base.space.units, strict=True))}.",
        f"Columns: {with_units((p.name, p.unit) for p in base.parameters)}; inertia about the sensor origin.",
    ]


def with_units(pairs: Iterable[tuple[str, str]]) -> str:
    """Names with their units in parentheses."""
    return ", ".join(f"{name} ({unit})" for name, unit in pairs)


def described(parameter: Parameter) -> str:
    """Name and unit of a parameter."""
    return comment(f"{parameter.name}, {parameter.unit}" if parameter.unit != "1" else parameter.name)


def paragraphs(texts: Iterable[str], width: int = WIDTH) -> list[str]:
    """Paragraphs as lines, an empty one between them, without anything that could end a comment."""
    lines: list[str] = []
    for text in texts:
        lines += ["", *wrap(comment(text), width, break_long_words=False, break_on_hyphens=False)]
    return lines[1:]
