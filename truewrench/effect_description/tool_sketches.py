"""Sketches of effects at the tool: forces on it, its mass, its attachment."""

from __future__ import annotations

from math import cos, radians, sin

from truewrench.effect_description.drawing import Drawing


def com_offset(d: Drawing) -> None:
    """The centre of mass beside the tip axis."""
    d.tool()
    d.line(120, 28, 120, 144, "faint")
    d.circle(152, 84, 5, "accent dot")
    d.text(162, 88, "centre of mass")
    d.dimension(120, 102, 152, 102, "mlx / m", (160, 112))


def gravity_tilt(d: Drawing) -> None:
    """Gravity as it is, and as it is assumed, perpendicular to the base."""
    turn = radians(14)
    d.path([(46 + 130 * u * cos(turn), 90 + 130 * u * sin(turn)) for u in (0, 1)])
    d.text(44, 84, "base", "end")
    d.arrow(120, 26, 120, 104)
    d.text(126, 100, "g")
    d.line(120, 26, 120 - 80 * sin(turn), 26 + 80 * cos(turn), "ghost")
    d.text(120, 144, "dashed: perpendicular to the base", "middle")
    d.arc(120, 26, 46, 90, 104)
    d.parameter(128, 62, "angle; tilt_x, tilt_y")


def viscous_drag(d: Drawing) -> None:
    """A force against the velocity, at a point of the tool."""
    _drag(d, "F = −c v")


def quadratic_drag(d: Drawing) -> None:
    """A force against the velocity, growing with its square, at a point of the tool."""
    _drag(d, "F = −c |v| v")


def _drag(d: Drawing, force: str) -> None:
    d.tool()
    d.circle(120, 108, 3, "accent dot")
    d.arrow(134, 108, 200, 108, "ink")
    d.text(204, 112, "v")
    d.arrow(120, 108, 52, 108)
    d.parameter(84, 126, force, "middle")
    d.line(126, 28, 166, 28, "faint")
    d.dimension(158, 28, 158, 106, "d", (164, 72))


def coulomb_friction(d: Drawing) -> None:
    """A torque of constant size against the rotation."""
    d.axes("angular velocity", "torque", centred=True)
    d.path([(32, 40), (116, 40), (120, 112), (210, 112)], "accent")
    d.dimension(62, 40, 62, 76, "level", (68, 62))


def cable_spring(d: Drawing) -> None:
    """A cable between a point of the tool and an anchor in the world, slack below its length."""
    d.tool()
    d.circle(120, 100, 3, "accent dot")
    spring = [(120, 100), (146, 94)]
    spring += [(150 + 8 * i, 94 - 2 * i + (6 if i % 2 else -6)) for i in range(5)]
    d.path([*spring, (190, 84), (214, 78)], "accent")
    d.line(214, 62, 214, 96)
    d.parameter(232, 52, "anchor_x, _y, _z", "end")
    d.parameter(150, 118, "k, length")
    d.line(80, 28, 114, 28, "faint")
    d.dimension(86, 28, 86, 100, "d", (80, 70), "end")


def tip_flexibility(d: Drawing) -> None:
    """The tool turns against a spring and a damper at the sensor."""
    d.tool(kind="ghost")
    d.tool(turn=-20)
    d.arc(120, 28, 62, 70, 90)
    d.text(130, 106, "θ")
    d.arc(120, 34, 16, -50, 110)
    d.parameter(146, 30, "stiffness,")
    d.parameter(146, 44, "damping")


def payload_change(d: Drawing) -> None:
    """A mass that is carried from a time on."""
    d.tool()
    d.box(106, 100, 28, 26, "accent")
    d.parameter(142, 118, "mass")
    d.parameter(142, 134, "from time on")
    d.line(80, 28, 114, 28, "faint")
    d.dimension(86, 28, 86, 112, "d", (80, 76), "end")


def contact_event(d: Drawing) -> None:
    """A wrench that acts during an interval."""
    d.axes("time", "force, torque")
    d.path([(34, 126), (92, 126), (94, 60), (166, 60), (168, 126), (214, 126)], "accent")
    d.parameter(92, 142, "start", "middle")
    d.parameter(168, 142, "end", "middle")
    d.dimension(128, 62, 128, 124, "fcx, ...", (134, 98))


TOOL_SKETCHES = (
    com_offset,
    gravity_tilt,
    viscous_drag,
    quadratic_drag,
    coulomb_friction,
    cable_spring,
    tip_flexibility,
    payload_change,
    contact_event,
)
