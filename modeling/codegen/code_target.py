"""Abstract target language of code generation, and the registry of targets."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar

from modeling.plugins import TARGETS, plugins

if TYPE_CHECKING:
    from modeling.codegen.fitted_model import FittedModel
    from modeling.codegen.rigid_tool_regressor import RigidToolRegressor


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
