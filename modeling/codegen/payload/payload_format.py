"""Abstract format of an identified tool, and the formats by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from modeling.codegen.payload.tool_inertia import ToolInertia

FORMATS = {
    "urdf": "modeling.codegen.payload.robot_description:Urdf",
    "sdf": "modeling.codegen.payload.robot_description:Sdf",
    "mjcf": "modeling.codegen.payload.robot_description:Mjcf",
    "ur": "modeling.codegen.payload.controller_payload:UniversalRobots",
    "franka": "modeling.codegen.payload.controller_payload:Franka",
    "ros2": "modeling.codegen.payload.controller_payload:Ros2Parameters",
}
"""Where the class of each format is; it is imported when first used."""


class PayloadFormat(ABC):
    """A format in which a robot's description or controller takes the tool.

    name  as `truewrench emit --to` takes it
    """

    name: ClassVar[str]

    @abstractmethod
    def text(self, tool: ToolInertia, source: str) -> str:
        """The tool in this format; `source` names the project and its version.

        Raises InputError where the format needs an inertia that was not identifiable.
        """


def payload_format(name: str) -> PayloadFormat:
    """The format of that name; KeyError for none."""
    found = resolve_name(FORMATS[name])()
    assert isinstance(found, PayloadFormat)
    return found


def remarks(tool: ToolInertia, source: str) -> list[str]:
    """What a reader of the file must know: origin, mass with its std, frame, and what the sensor does not weigh."""
    return [
        f"tool identified by {source}: {tool.mass:.5g} kg, std {tool.mass_std:.2g} kg",
        f"frame: {tool.frame}; m, kg, kg m²; inertia about the centre of mass, along the axes of that frame",
        "the part of the sensor between the flange and its strain gauges is not included: the sensor does not weigh it",
    ]
