"""Abstract format of an identified tool, and the formats by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar

from modeling.number_format import estimate_text

if TYPE_CHECKING:
    from modeling.codegen.tool_inertia import ToolInertia


MOMENTS = {"Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Ixz": (0, 2), "Iyz": (1, 2)}
"""Elements of an inertia, in the order in which they are listed."""
FORMATS = {
    "urdf": "modeling.codegen.payload:Urdf",
    "sdf": "modeling.codegen.payload:Sdf",
    "mjcf": "modeling.codegen.payload:Mjcf",
    "ur": "modeling.codegen.payload:UniversalRobots",
    "franka": "modeling.codegen.payload:Franka",
    "ros2": "modeling.codegen.payload:Ros2Parameters",
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
    chosen = resolve_name(FORMATS[name])()
    assert isinstance(chosen, PayloadFormat)
    return chosen


def remarks(tool: ToolInertia, source: str) -> list[str]:
    """What a reader of the file must know: origin, values with their std, frame, what the sensor does not weigh."""
    mass = estimate_text(tool.mass, tool.mass_std, "kg")
    centre = _listed(zip("xyz", tool.centre_of_mass, tool.centre_std, strict=True))
    sentences = [
        f"tool identified by {source}; value ± standard deviation, rounded here:",
        f"mass {mass}",
        f"centre of mass (m) {centre}",
    ]
    if tool.inertia is not None:
        moments = [(name, tool.inertia[at], tool.inertia_std[at]) for name, at in MOMENTS.items()]
        sentences.append(f"inertia about the centre of mass, along the frame's axes (kg m²) {_listed(moments)}")
    sentences += [
        f"frame: {tool.frame}",
        *([tool.turn] if tool.turn else []),
        *([tool.left_out] if tool.left_out else []),
        "the part of the sensor between the flange and its strain gauges is not included: the sensor does not weigh it",
    ]
    return [" ".join(remark.split()) for remark in sentences]  # each is one line of a comment, whatever is in it


def _listed(estimates: Iterable[tuple[str, float, float]]) -> str:
    """Names, values and stds."""
    return ", ".join(f"{name} {estimate_text(float(value), float(std), '1')}" for name, value, std in estimates)


def where_it_goes(tool: ToolInertia, element: str, host: str) -> str:
    """How an element of a robot description is added to an existing one; `host` is its link or body."""
    name = f'the {host} "{tool.link}"' if tool.link else f"the {host} whose frame is the {tool.frame}"
    return (
        f"to add it to a robot, copy the {element} element into {name}, if that has none;"
        f' else copy the {host} "tool", and fix it there at a zero pose'
    )
