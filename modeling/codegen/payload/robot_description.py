"""The tool as a link of a robot description: URDF, SDF, MJCF."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Comment, Element, ElementTree, SubElement, indent, tostring

import numpy as np
from numpy.typing import NDArray

from modeling.codegen.payload.payload_format import PayloadFormat, remarks, where_it_goes
from modeling.codegen.payload.tool_inertia import ToolInertia

Array = NDArray[np.float64]

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
        inertia = tool.required_inertia(self.name)
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
        moments, inertia = tool.required_inertia(self.name), SubElement(inertial, "inertia")
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
        inertia = tool.required_inertia(self.name)
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
