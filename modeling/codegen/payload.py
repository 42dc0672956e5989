"""The identified tool as a payload: for robot controllers and robot descriptions."""

from __future__ import annotations

import json
from collections.abc import Iterable
from xml.etree.ElementTree import Comment, Element, ElementTree, SubElement, indent, tostring

import numpy as np
from numpy.typing import NDArray

from modeling.codegen.code_target import MOMENTS, PayloadFormat, remarks, where_it_goes
from modeling.codegen.tool_inertia import ALONG_POSE, STATED_FRAME, ToolInertia

Array = NDArray[np.float64]

# The tool as robot controllers take it: Universal Robots, Franka, parameters of a ROS 2 node.


FLANGE = "the controller takes them in the flange's frame: where that is another one, emit with --sensor-pose"
OF_POSE = (
    "the controller takes them in the flange's frame, whose axes these are if its pose was logged; else, or where its"
    " origin is not the sensor's, emit with --sensor-pose, the pose of the sensor's own axes"
)
"""The same of axes of a logged pose that the sensor's are turned against."""


STATED = "the controller takes them in the flange's frame, as which that one was stated"
"""The same of a frame that `--sensor-pose` states."""


def _flange(tool: ToolInertia) -> str:
    """Which frame the controller takes the tool in, and what to do where this is another one."""
    if tool.frame.startswith(ALONG_POSE):
        return OF_POSE
    return STATED if tool.frame.startswith(STATED_FRAME) else FLANGE


class UniversalRobots(PayloadFormat):
    """URScript: `set_payload` with mass and centre of mass, and the call with inertia as a comment.

    The controller's frame is the tool flange. Inertia about the centre of mass along the flange's axes, in the order
    Ixx, Iyy, Izz, Ixy, Ixz, Iyz (URScript manual, `set_target_payload`).
    """

    name = "ur"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The script."""
        lines = [f"# {remark}" for remark in remarks(tool, source)]
        lines += [f"# {_flange(tool)}; mass (kg), centre of mass [x, y, z] (m):"]
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
            f"// {_flange(tool)}; mass (kg), centre of mass (m), and inertia about it (kg m²)",
            "// by columns Ixx, Ixy, Ixz, Ixy, Iyy, Iyz, Ixz, Iyz, Izz",
        ]
        lines += [
            f"robot.setLoad({tool.mass!r},",
            f"              {{{{{_joined(tool.centre_of_mass)}}}}},",
            f"              {{{{{_joined(columns)}}}}});",
        ]
        return "\n".join(lines) + "\n"


class Ros2Parameters(PayloadFormat):
    """Parameters of a ROS 2 node in YAML, as released packages declare them.

    force_torque_sensor_broadcaster (ros2_controllers) adds `offset` to the readings, then runs `sensor_filter_chain`,
    in which GravityCompensationWrench (control_toolbox) subtracts mass times `gravity_field`, turned from `world_frame`
    into `sensor_frame`, at `CoG`. `gravity_compensation` is the admittance controller's (ros2_controllers).
    """

    name = "ros2"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The parameter file, of any node; another node ignores what it does not declare."""
        readings = tool.readings
        assert readings is not None
        frame = json.dumps(tool.link or "ft_sensor")
        lines = [f"# {remark}" for remark in remarks(tool, source)]
        if tool.inertia is not None:
            moments = _list(np.ravel(tool.inertia))
            lines.append(
                f"# inertia about the centre of mass (kg m²), row by row, which no filter here uses: {moments}"
            )
        lines += [
            "# The filter takes out weight and zero alone: of a moving arm the tool's inertia stays in the readings,",
            "# and so does each effect of the model. Gravity's sign is that of the readings: a hanging weight reads",
            f"# {'along' if readings.sign > 0 else 'against'} gravity.",
            "/**:",
            "  ros__parameters:",
            f"    frame_id: {frame}  # the name that tf has for the sensor's own axes",
            "    offset:  # is added to the readings: minus what the sensor reads without load (N, N m)",
        ]
        for quantity, values in (("force", readings.zero[:3]), ("torque", readings.zero[3:])):
            lines.append(
                f"      {quantity}: {{{', '.join(f'{a}: {_decimal(-v)}' for a, v in zip('xyz', values, strict=True))}}}"
            )
        lines += [
            "    sensor_filter_chain:",
            "      filter1:",
            '        type: "control_filters/GravityCompensationWrench"',
            '        name: "gravity_compensation"',
            "        params:",
            '          world_frame: "base_link"  # along whose axes gravity is given: that of the recorded motion',
            f"          sensor_frame: {frame}  # in which the centre of mass is given, as said above",
            "          tool:",
            f"            mass: {_decimal(tool.mass)}",
            f"            CoG: {_list(tool.centre_of_mass)}",
            f"            gravity_field: {_list(readings.sign * readings.gravity)}",
            "    gravity_compensation:  # of the admittance controller, for a level base and readings along gravity",
            f"      frame: {{id: {frame}}}",
            "      CoG:",
            f"        pos: {_list(tool.centre_of_mass)}",
            f"        force: {_decimal(tool.mass * float(np.linalg.norm(readings.gravity)))}  # weight, N",
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


# The tool as a link of a robot description: URDF, SDF, MJCF.


TRIANGLE = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
"""Names of the elements of an inertia in URDF and SDF."""


class Urdf(PayloadFormat):
    """URDF: a robot of one link `tool`, whose `inertial` element is for copying; the link's frame is the tool's."""

    name = "urdf"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The robot."""
        root = _root("robot", tool, source, name="tool")
        inertial = SubElement(SubElement(root, "link", name="tool"), "inertial")
        SubElement(inertial, "origin", xyz=_numbers(tool.centre_of_mass), rpy="0 0 0")
        SubElement(inertial, "mass", value=repr(tool.mass))
        inertia = tool.solid_inertia(self.name)
        SubElement(inertial, "inertia", {name: _number(inertia[at]) for name, at in TRIANGLE.items()})
        return _document(root)


class Sdf(PayloadFormat):
    """SDF: a model of one link `tool`; the link's frame is the tool's."""

    name = "sdf"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The model."""
        root = _root("sdf", tool, source, version="1.7")
        inertial = SubElement(SubElement(SubElement(root, "model", name="tool"), "link", name="tool"), "inertial")
        SubElement(inertial, "pose").text = f"{_numbers(tool.centre_of_mass)} 0 0 0"
        SubElement(inertial, "mass").text = repr(tool.mass)
        moments, inertia = tool.solid_inertia(self.name), SubElement(inertial, "inertia")
        for name, at in TRIANGLE.items():
            SubElement(inertia, name).text = _number(moments[at])
        return _document(root)


class Mjcf(PayloadFormat):
    """MuJoCo's MJCF: a free body `tool`, whose `inertial` element is for copying; the body's frame is the tool's."""

    name = "mjcf"

    def text(self, tool: ToolInertia, source: str) -> str:
        """The model."""
        root = _root("mujoco", tool, source, model="tool")
        body = SubElement(SubElement(root, "worldbody"), "body", name="tool")
        SubElement(body, "freejoint")
        inertia = tool.solid_inertia(self.name)
        full = [inertia[TRIANGLE[name]] for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        where = {"pos": _numbers(tool.centre_of_mass), "mass": repr(tool.mass), "fullinertia": _numbers(full)}
        SubElement(body, "inertial", where)
        return _document(root)


def _root(tag: str, tool: ToolInertia, source: str, **attributes: str) -> Element:
    root = Element(tag, attributes)
    said = [*remarks(tool, source), where_it_goes(tool, "inertial", "body" if tag == "mujoco" else "link")]
    root.extend(Comment(f" {remark.replace('--', '- ')} ") for remark in said)
    return root


def _document(root: Element) -> str:
    indent(ElementTree(root))
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'


def _numbers(values: Iterable[float]) -> str:
    return " ".join(map(_number, values))


def _number(value: float) -> str:
    """The shortest decimal text that reads back as the same number."""
    return repr(float(value))
