"""What `emit` writes, by name: abstract target languages of code, and abstract formats of an identified tool."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar

from modeling.number_format import estimate_text
from modeling.plugins import TARGETS, plugins

if TYPE_CHECKING:
    from modeling.codegen.fitted_model import FittedModel, RigidToolRegressor
    from modeling.codegen.tool_inertia import ToolInertia


class CodeTarget(ABC):
    """A language in which the rigid tool's regressor and a fitted model are written.

    name     of the language, as `truewrench emit --to` takes it
    suffix   of its files
    sampled  whether a model is written as a program of one sample, which needs the sampling interval
    """

    name: ClassVar[str]
    suffix: ClassVar[str]
    sampled: ClassVar[bool] = True

    @abstractmethod
    def regressor(self, base: RigidToolRegressor, source: str) -> str:
        """The regressor of the rigid tool, in the inputs of FORMATS; `source` names the project and its version."""

    @abstractmethod
    def model(self, fitted: FittedModel, source: str) -> str:
        """Prediction, contact wrench and derivative of a fitted model; `source` names the project and its version.

        Raises InputError where it is `sampled` and the model has memory but no dt, or no realisation in discrete time.
        """


_TARGETS: dict[str, str | CodeTarget] = {
    "numpy": "modeling.codegen.template:NumpyTarget",
    "casadi": "modeling.codegen.casadi_target:CasadiTarget",
    "c": "modeling.codegen.template:CTarget",
    "latex": "modeling.codegen.latex_target:LatexTarget",
}
"""Targets by name, or where their classes are: those are imported when first used."""
BUILT_IN = tuple(_TARGETS)
"""Names of those that every installation has."""


def target_names() -> tuple[str, ...]:
    """The names of all targets, also of packages installed beside."""
    plugins(TARGETS, _registered)
    return tuple(_TARGETS)


def code_target(name: str) -> CodeTarget:
    """The target of that name; KeyError for none."""
    plugins(TARGETS, _registered)
    registered = _TARGETS[name]
    target = resolve_name(registered)() if isinstance(registered, str) else registered
    assert isinstance(target, CodeTarget)
    return target


def register_target(target: CodeTarget) -> None:
    """Add a target, so that `truewrench emit` of this process takes its name."""
    _TARGETS[target.name] = target


def _registered(kind: type[CodeTarget]) -> type[CodeTarget]:
    """A target of another package, added; TypeError or ValueError where it is none, or its name is taken."""
    if not (isinstance(kind, type) and issubclass(kind, CodeTarget)):
        raise TypeError("no class of targets")
    if kind.name in _TARGETS:
        raise ValueError(f"the name {kind.name} is taken")
    register_target(kind())
    return kind


# The identified tool, as robot descriptions and controllers take it.


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
CALIBRATIONS = ("calibration", "calibration_csv", "calibration_ati")
"""Files of the sensor: parameters in YAML, a table, and a maker's file with the correction."""


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
