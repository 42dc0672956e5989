"""Code of a model in a target language, with its operation count."""

from __future__ import annotations

from dataclasses import dataclass

from modeling.codegen.code_target import CodeTarget
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
from modeling.compiled.straight_line_program import OperationCount, StraightLineProgram
from modeling.table import Column, Table


@dataclass(frozen=True)
class GeneratedCode:
    """The text, and operations per sample: by name, with common subexpressions shared and without."""

    text: str
    costs: tuple[tuple[str, OperationCount, OperationCount], ...]

    @classmethod
    def of_base(cls, base: RigidToolRegressor, target: CodeTarget, source: str) -> GeneratedCode:
        """The regressor of the rigid tool; `source` names the project and its version."""
        return cls(target.regressor(base, source), (operation_cost("regressor", base.program),))

    @classmethod
    def of_fitted(cls, fitted: FittedModel, target: CodeTarget, source: str) -> GeneratedCode:
        """Prediction, compensation and derivative of a fitted model; InputError as from `CodeTarget.model`."""
        text = target.model(fitted, source)
        if not target.sampled:
            return cls(text, (operation_cost("load and bias", fitted.reading),))
        shared, unshared = (fitted.program.operations(shared=shared) for shared in (True, False))
        derivative = fitted.sensitivity
        costs = [] if derivative is None else [operation_cost(fitted.derivative_name, derivative)]
        return cls(text, (("prediction", shared, unshared), *costs))

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
