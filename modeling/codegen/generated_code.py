"""Code of a model in a target language, with its operation count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from modeling.codegen.c_target import c_model, c_regressor
from modeling.codegen.casadi_target import casadi_model, casadi_regressor
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.latex_target import latex_model, latex_regressor
from modeling.codegen.numpy_target import numpy_model, numpy_regressor
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.dynamics.discrete_deflection import NEWTON_STEPS
from modeling.expressions.operation_count import OperationCount
from modeling.expressions.straight_line_program import StraightLineProgram
from modeling.table import Column, Table


class Language(Enum):
    """Target languages of code generation."""

    NUMPY = "numpy"
    CASADI = "casadi"
    C = "c"
    LATEX = "latex"


@dataclass(frozen=True)
class GeneratedCode:
    """The text, and operations per sample: by name, with common subexpressions shared and without."""

    text: str
    costs: tuple[tuple[str, OperationCount, OperationCount], ...]

    @classmethod
    def of_base(cls, base: RigidToolRegressor, language: Language, source: str) -> GeneratedCode:
        """The regressor of the rigid tool; `source` names the project and its version."""
        writers: dict[Language, Callable[[], str]] = {
            Language.NUMPY: lambda: numpy_regressor(base, source),
            Language.CASADI: lambda: str(casadi_regressor(base).serialize()),
            Language.C: lambda: c_regressor(base, source),
            Language.LATEX: lambda: latex_regressor(base, source),
        }
        return cls(writers[language](), (operation_cost("regressor", base.program),))

    @classmethod
    def of_fitted(cls, fitted: FittedModel, language: Language, source: str) -> GeneratedCode:
        """Prediction, compensation and derivative of a fitted model.

        Raises InputError, but for LATEX, when it has memory and no dt, or no stable proper rational realisation.
        """
        writers: dict[Language, Callable[[], str]] = {
            Language.NUMPY: lambda: numpy_model(fitted, source),
            Language.CASADI: lambda: str(casadi_model(fitted).serialize()),
            Language.C: lambda: c_model(fitted, source),
            Language.LATEX: lambda: latex_model(fitted, source),
        }
        text = writers[language]()
        costs = [operation_cost("load and bias", fitted.program)]
        if language is not Language.LATEX:
            costs.append(("dynamics and contact", fitted.output_operations, fitted.output_operations))
        if fitted.equilibrium is not None:
            costs.append(operation_cost(f"deflection, {NEWTON_STEPS} Newton steps", fitted.equilibrium))
        if fitted.sensitivity is not None:
            costs.append(operation_cost(fitted.derivative_name, fitted.sensitivity))
        return cls(text, tuple(costs))

    @property
    def table(self) -> Table:
        """Operations per sample, with common subexpressions shared and without."""
        counts = []
        for name, shared, unshared in self.costs:
            counts += [(name, shared)] + [(f"{name}, without shared subexpressions", unshared)] * (unshared != shared)
        rows = [(name, c.total, c.sums, c.products, c.quotients, c.calls) for name, c in counts]
        numbers = (Column(name, format="d") for name in ("all", "+ -", "*", "/", "functions"))
        return Table.of(("operations per sample", *numbers), rows)


def operation_cost(name: str, program: StraightLineProgram) -> tuple[str, OperationCount, OperationCount]:
    """A program's operations under a name: shared, unshared."""
    return name, program.shared.operations, program.operations_unshared
