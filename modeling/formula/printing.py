"""Printing: a SymPy expression as the text of a formula; whether a formula may say that, the parser decides."""

from __future__ import annotations

import re

from sympy.printing.str import StrPrinter

from modeling import symbolic as sp
from modeling.errors import InputError
from modeling.formula.source import Source
from modeling.formula.tokens import LONGEST
from modeling.shown import shown

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def printed(expression: sp.Expr | float, *, where: str = "formula") -> str:
    """The text of a formula that says what the expression says.

    Functions that no formula has print by SymPy's names, which the parser then refuses. Raises InputError for symbols
    whose name is more than a name, for numbers that are not real and finite, and for what is not an expression.
    """
    remedy = "use SymPy expressions of plainly named symbols, or text"
    try:
        found = sp.sympify(expression, strict=True)
        for atom in found.atoms():
            if isinstance(atom, sp.Symbol) and not _NAME.fullmatch(atom.name):
                raise InputError(what=f"the symbol {shown(atom.name)} is no name", where=where, remedy=remedy)
            if not isinstance(atom, sp.Symbol) and not (atom.is_number and atom.is_finite and atom.is_real):
                raise InputError(what=f"{atom} is no finite real number", where=where, remedy=remedy)
        text = str(_Printer().doprint(found))
    except (sp.SympifyError, AttributeError, RecursionError):
        raise InputError(what="this is no expression that a formula can say", where=where, remedy=remedy) from None
    if len(text) > LONGEST:
        raise Source(text, where).refusal(LONGEST + 1, f"it prints as {len(text)} characters", "divide it into steps")
    return text


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's printer with the names and all the digits of a formula."""

    def _print_Float(self, e: sp.Float) -> str:  # noqa: N802
        return repr(float(e))

    def _print_Exp1(self, e: sp.Expr) -> str:  # noqa: N802
        return "exp(1)"

    def _print_Abs(self, e: sp.Expr) -> str:  # noqa: N802
        return f"abs({self._print(e.args[0])})"

    def _print_Max(self, e: sp.Expr) -> str:  # noqa: N802
        return f"max({self.stringify(e.args, ', ')})"

    def _print_Min(self, e: sp.Expr) -> str:  # noqa: N802
        return f"min({self.stringify(e.args, ', ')})"

    def _print_Pow(self, e: sp.Expr, rational: bool = False) -> str:  # noqa: N802
        return str(super()._print_Pow(e, rational)).replace("**", "^")
