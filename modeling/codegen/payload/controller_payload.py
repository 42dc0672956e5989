"""The tool as robot controllers take it: Universal Robots, Franka, parameters of a ROS 2 node."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from modeling.codegen.payload.payload_format import MOMENTS, PayloadFormat, remarks
from modeling.codegen.payload.tool_inertia import ToolInertia
from modeling.rig.rig import STANDARD_GRAVITY

FLANGE = "the controller takes them in the flange's frame: where that is another one, emit with --sensor-pose"


class UniversalRobots(PayloadFormat):
    """URScript: `set_payload` with mass and centre of mass, and the call with inertia as a comment.

    The controller's frame is the tool flange. Inertia about the centre of mass along the flange's axes, in the order
    Ixx, Iyy, Izz, Ixy, Ixz, Iyz (URScript manual, `set_target_payload`).
    """

    name = "ur"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The script."""
        lines = [f"# {remark}" for remark in remarks(tool, source)]
        lines += [f"# {FLANGE}; mass (kg), centre of mass [x, y, z] (m):"]
        lines.append(f"set_payload({tool.mass!r}, {_list(tool.centre_of_mass)})")
        if tool.inertia is not None:
            moments = _list(tool.inertia[at] for at in MOMENTS.values())
            lines.append("# with inertia, on controllers that have it, the next line instead, which takes:")
            lines.append(f"# mass (kg), centre of mass [x, y, z] (m), inertia about it [{', '.join(MOMENTS)}] (kg m²)")
            lines.append(f"# set_target_payload({tool.mass!r}, {_list(tool.centre_of_mass)}, {moments})")
        return "\n".join(lines) + "\n"


class Franka(PayloadFormat):
    """libfranka: `Robot::setLoad` with mass, flange to centre of mass, and the inertia column by column."""

    name = "franka"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The call in C++."""
        columns = np.ravel(tool.required_inertia(self.name), order="F")
        lines = [f"// {remark}" for remark in remarks(tool, source)]
        lines += [
            f"// {FLANGE}; mass (kg), centre of mass (m), and inertia about it (kg m²)",
            "// by columns Ixx, Ixy, Ixz, Ixy, Iyy, Iyz, Ixz, Iyz, Izz",
        ]
        lines += [
            f"robot.setLoad({tool.mass!r},",
            f"              {{{{{_joined(tool.centre_of_mass)}}}}},",
            f"              {{{{{_joined(columns)}}}}});",
        ]
        return "\n".join(lines) + "\n"


class Ros2Parameters(PayloadFormat):
    """Parameters of a ROS 2 node in YAML: `tool`, and `gravity_compensation` as ros2_controllers' admittance
    controller has it (position of the centre of gravity, m, and weight, N).
    """

    name = "ros2"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The parameter file, of any node."""
        lines = [f"# {remark}" for remark in remarks(tool, source)]
        lines += [
            "/**:",
            "  ros__parameters:",
            "    tool:",
            f"      mass: {_decimal(tool.mass)}",
            f"      center_of_mass: {_list(tool.centre_of_mass)}",
        ]
        if tool.inertia is not None:
            lines.append(f"      inertia: {_list(np.ravel(tool.inertia))}  # row by row, symmetric")
        lines += [
            "    gravity_compensation:",
            "      CoG:",
            f"        pos: {_list(tool.centre_of_mass)}",
            f"        force: {_decimal(tool.mass * STANDARD_GRAVITY)}  # weight at {STANDARD_GRAVITY} m/s², N",
        ]
        return "\n".join(lines) + "\n"


def _joined(values: Iterable[float]) -> str:
    return ", ".join(map(_decimal, values))


def _list(values: Iterable[float]) -> str:
    return f"[{_joined(values)}]"


def _decimal(value: float) -> str:
    """The shortest text that reads back as the same number, with a point even before an exponent (YAML 1.1)."""
    text = repr(float(value))
    return text if "." in text or "e" not in text else text.replace("e", ".0e")
