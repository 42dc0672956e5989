"""SymPy expressions printed as formulas; the parser then decides whether they are valid."""

from __future__ import annotations

import re

from sympy.printing.str import StrPrinter

from modeling import symbolic as sp
from modeling.errors import InputError, quoted
from modeling.formulas.source import FormulaSource
from modeling.formulas.tokens import LONGEST_FORMULA

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def formula_text(expression: sp.Expr | float, *, where: str = "formula") -> str:
    """The text of a formula equal to the expression.

    Functions unknown to formulas print by SymPy's names, which the parser then rejects. Raises InputError for symbols
    whose name is not an identifier, for numbers that are not real and finite, and for anything but an expression.
    """
    remedy = "use text, or SymPy expressions of symbols named by letters, digits and _"
    try:
        found = sp.sympify(expression, strict=True)
        for atom in found.atoms():
            if isinstance(atom, sp.Symbol) and not _NAME.fullmatch(atom.name):
                raise InputError(what=f"the symbol name {quoted(atom.name)} is not valid", where=where, remedy=remedy)
            if not isinstance(atom, sp.Symbol) and not (atom.is_number and atom.is_finite and atom.is_real):
                raise InputError(what=f"{atom} is not a finite real number", where=where, remedy=remedy)
        text = str(_Printer().doprint(found))
    except (sp.SympifyError, AttributeError, RecursionError):
        raise InputError(what="this expression cannot be written as a formula", where=where, remedy=remedy) from None
    if len(text) > LONGEST_FORMULA:
        raise FormulaSource(text, where).error(
            LONGEST_FORMULA + 1, f"it prints as {len(text)} characters", "divide it into steps"
        )
    return text


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's printer with the function names of formulas and all digits."""

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
