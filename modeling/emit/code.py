"""Code: a model in a language of the outside world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from modeling.emit.base import BaseRegressor
from modeling.emit.c_model import c_model
from modeling.emit.c_regressor import c_regressor
from modeling.emit.casadi_model import casadi_model
from modeling.emit.casadi_regressor import casadi_regressor
from modeling.emit.fitted import FittedModel
from modeling.emit.latex_model import latex_model
from modeling.emit.latex_regressor import latex_regressor
from modeling.emit.numpy_model import numpy_model
from modeling.emit.numpy_regressor import numpy_regressor
from modeling.emit.operations import Operations
from modeling.emit.program import Program
from modeling.running_bend import NEWTON_STEPS

OPERATIONS = ("operations per sample", "all", "+ -", "*", "/", "functions")


class Language(Enum):
    """What code can be written in."""

    NUMPY = "numpy"
    CASADI = "casadi"
    C = "c"
    LATEX = "latex"


@dataclass(frozen=True)
class Code:
    """The text, and what a sample takes: by name, with every common subexpression shared and with none."""

    text: str
    costs: tuple[tuple[str, Operations, Operations], ...]

    @classmethod
    def of_base(cls, base: BaseRegressor, language: Language, source: str) -> Code:
        """The regressor of a base model; `source` names the project and its version."""
        writers: dict[Language, Callable[[], str]] = {
            Language.NUMPY: lambda: numpy_regressor(base, source),
            Language.CASADI: lambda: str(casadi_regressor(base).serialize()),
            Language.C: lambda: c_regressor(base, source),
            Language.LATEX: lambda: latex_regressor(base, source),
        }
        return cls(writers[language](), (cost("regressor", base.program),))

    @classmethod
    def of_fitted(cls, fitted: FittedModel, language: Language, source: str) -> Code:
        """Prediction, compensation and derivative of a fitted model.

        Raises InputError when it remembers and has no dt, or cannot be run sample by sample; formulas need neither.
        """
        writers: dict[Language, Callable[[], str]] = {
            Language.NUMPY: lambda: numpy_model(fitted, source),
            Language.CASADI: lambda: str(casadi_model(fitted).serialize()),
            Language.C: lambda: c_model(fitted, source),
            Language.LATEX: lambda: latex_model(fitted, source),
        }
        text = writers[language]()
        costs = [cost("load and zero", fitted.program)]
        if language is not Language.LATEX:
            costs.append(("memory and contact", fitted.rest, fitted.rest))
        if fitted.equilibrium is not None:
            costs.append(cost(f"equilibrium of the bend, {NEWTON_STEPS} times", fitted.equilibrium))
        if fitted.sensitivity is not None:
            costs.append(cost(fitted.derivative_name, fitted.sensitivity))
        return cls(text, tuple(costs))

    def rows(self) -> list[tuple[str, ...]]:
        """Numbers of operations per sample under OPERATIONS, with shared subexpressions and without, as text."""
        named = []
        for name, shared, each in self.costs:
            named += [(name, shared)] + [(f"{name}, nothing shared", each)] * (each != shared)
        return [(name, *(str(n) for n in (c.total, c.sums, c.products, c.quotients, c.calls))) for name, c in named]


def cost(name: str, program: Program) -> tuple[str, Operations, Operations]:
    """A program's operations under a name."""
    return name, program.shared.operations, program.operations_unshared
