"""Functions that a formula may call: in SymPy, on floats, and their rule for units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from modeling import symbolic as sp

MOST_ARGUMENTS = 8
"""Arguments of min and max at most."""


class UnitRule(Enum):
    """Units of a function's arguments, and the unit of its value."""

    NUMBER = "dimensionless (or an angle) in, dimensionless out"
    SAME = "arguments of one unit in, the same unit out"
    RATIO = "arguments of one unit in, dimensionless out"
    ROOT = "the root of the argument's unit out"


@dataclass(frozen=True)
class FormulaFunction:
    """A function; `usage` is its call, `least` and `most` its number of arguments.

    expression  its SymPy expression, of functions that NumPy, CasADi and C have
    number      its value on floats, for constant arguments; ValueError or OverflowError where undefined
    """

    usage: str
    least: int
    most: int
    rule: UnitRule
    expression: Callable[..., sp.Expr]
    number: Callable[..., float]

    @property
    def name(self) -> str:
        """Its name."""
        return self.usage.partition("(")[0]


def _unevaluated(name: str) -> Callable[..., sp.Expr]:
    """SymPy's function of that name, unevaluated: sorting or simplifying nested arguments would take seconds."""
    return lambda *arguments: getattr(sp, name)(*arguments, evaluate=False)


def _root(x: sp.Expr) -> sp.Expr:
    return sp.Pow(x, sp.S.Half, evaluate=False)


def _sign(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return sp.tanh(x / width, evaluate=False)


def _step(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return (1 + _sign(x, width)) / 2


FORMULA_FUNCTIONS: Mapping[str, FormulaFunction] = {
    function.name: function
    for function in (
        FormulaFunction("sin(x)", 1, 1, UnitRule.NUMBER, _unevaluated("sin"), math.sin),
        FormulaFunction("cos(x)", 1, 1, UnitRule.NUMBER, _unevaluated("cos"), math.cos),
        FormulaFunction("tan(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tan"), math.tan),
        FormulaFunction("tanh(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tanh"), math.tanh),
        FormulaFunction("exp(x)", 1, 1, UnitRule.NUMBER, _unevaluated("exp"), math.exp),
        FormulaFunction("sqrt(x)", 1, 1, UnitRule.ROOT, _root, math.sqrt),
        FormulaFunction("abs(x)", 1, 1, UnitRule.SAME, _unevaluated("Abs"), math.fabs),
        FormulaFunction("min(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Min"), min),
        FormulaFunction("max(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Max"), max),
        FormulaFunction("atan2(y, x)", 2, 2, UnitRule.RATIO, _unevaluated("atan2"), math.atan2),
        FormulaFunction("sign(x, width)", 2, 2, UnitRule.RATIO, _sign, lambda x, width: math.tanh(x / width)),
        FormulaFunction("step(x, width)", 2, 2, UnitRule.RATIO, _step, lambda x, width: (1 + math.tanh(x / width)) / 2),
    )
}
"""By name. A step has no derivative for a fit: sign(x, width) is tanh(x / width), from -1 to 1 over some widths, and
step(x, width) is (1 + sign(x, width)) / 2. min, max and abs are continuous, and exact."""
