"""Functions: those that a formula may call, each as SymPy, as a number and with what it does to units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from modeling import symbolic as sp

MOST_ARGUMENTS = 8
"""Of min and max."""


class UnitRule(Enum):
    """What a function asks of the units of its arguments, and the unit that it returns."""

    NUMBER = "a pure number (or an angle) in, a pure number out"
    SAME = "arguments of one unit in, the same unit out"
    RATIO = "arguments of one unit in, a pure number out"
    ROOT = "the root of the argument's unit out"


@dataclass(frozen=True)
class Function:
    """A function of one argument or more; `usage` is how it is called.

    expression  in SymPy, of expressions that NumPy, CasADi and C have
    number      of floats, for arguments that are constant; ValueError or OverflowError where there is no value
    """

    usage: str
    least: int
    most: int
    rule: UnitRule
    expression: Callable[..., sp.Expr]
    number: Callable[..., float]

    @property
    def name(self) -> str:
        """What it is called by."""
        return self.usage.partition("(")[0]


def _unevaluated(name: str) -> Callable[..., sp.Expr]:
    """SymPy's function of that name as it stands: to order or simplify nested arguments would take seconds."""
    return lambda *arguments: getattr(sp, name)(*arguments, evaluate=False)


def _root(x: sp.Expr) -> sp.Expr:
    return sp.Pow(x, sp.S.Half, evaluate=False)


def _sign(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return sp.tanh(x / width, evaluate=False)


def _step(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return (1 + _sign(x, width)) / 2


FUNCTIONS: Mapping[str, Function] = {
    function.name: function
    for function in (
        Function("sin(x)", 1, 1, UnitRule.NUMBER, _unevaluated("sin"), math.sin),
        Function("cos(x)", 1, 1, UnitRule.NUMBER, _unevaluated("cos"), math.cos),
        Function("tan(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tan"), math.tan),
        Function("tanh(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tanh"), math.tanh),
        Function("exp(x)", 1, 1, UnitRule.NUMBER, _unevaluated("exp"), math.exp),
        Function("sqrt(x)", 1, 1, UnitRule.ROOT, _root, math.sqrt),
        Function("abs(x)", 1, 1, UnitRule.SAME, _unevaluated("Abs"), math.fabs),
        Function("min(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Min"), min),
        Function("max(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Max"), max),
        Function("atan2(y, x)", 2, 2, UnitRule.RATIO, _unevaluated("atan2"), math.atan2),
        Function("sign(x, width)", 2, 2, UnitRule.RATIO, _sign, lambda x, width: math.tanh(x / width)),
        Function("step(x, width)", 2, 2, UnitRule.RATIO, _step, lambda x, width: (1 + math.tanh(x / width)) / 2),
    )
}
"""By name. A jump has no derivative for a refit to follow: sign(x, width) is tanh(x / width), -1 to 1 over some
widths, and step(x, width) is (1 + sign(x, width)) / 2. min, max and abs have a kink only, and stay exact."""
