"""Regressor of the rigid tool in the inputs of FORMATS.

Equations 22.x: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et
al.).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel, planar
from modeling.chain.regressor import regressor
from modeling.compiled.straight_line_program import StraightLineProgram
from modeling.parameter import Parameter
from modeling.rigid_body import newton_euler, rigid_body
from modeling.space import Space, signals, vector


@dataclass(frozen=True)
class RigidToolRegressor:
    """Phi (p, k) with reading = Phi theta, convention `on_tool`: 22.8 in the plane, 6 x 16 in six axes.

    Inputs in the plane: ax, ay, phi, dphi, ddphi, and g = 9.806 m/s². In six axes a, omega, alpha of the sensor
    origin in the sensor frame, with a its acceleration minus gravity: the load depends on the orientation only
    through it.
    """

    space: Space

    @property
    def arguments(self) -> dict[str, tuple[str, ...]]:
        """The arguments with their components, in order."""
        if self.space is Space.PLANE:
            return {name: (name,) for name in ("ax", "ay", "phi", "dphi", "ddphi")}
        return {name: tuple(f"{name}_{axis}" for axis in "xyz") for name in ("a", "omega", "alpha")}

    @property
    def inputs(self) -> tuple[str, ...]:
        """The components of all arguments, in order."""
        return tuple(name for components in self.arguments.values() for name in components)

    @cached_property
    def model(self) -> WrenchModel:
        """The rigid-tool model."""
        return planar() if self.space is Space.PLANE else WrenchModel(space=self.space)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of the columns."""
        return self.model.parameters

    @cached_property
    def matrix(self) -> sp.Matrix:
        """Phi (p, k), symbolic."""
        if self.space is Space.PLANE:
            return regressor(self.model)
        lift, omega, alpha = (vector(*signals(*components)) for components in self.arguments.values())
        wrench = sp.Matrix.vstack(*newton_euler(rigid_body(self.space), lift, omega, alpha))
        return (wrench + self.model.bias).applyfunc(sp.expand).jacobian([p.symbol for p in self.parameters])

    @cached_property
    def program(self) -> StraightLineProgram:
        """The elements of Phi, row by row."""
        return StraightLineProgram.of(list(self.matrix))
