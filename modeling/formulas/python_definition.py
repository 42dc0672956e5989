"""Custom effects defined in Python, their formulas as text or SymPy expressions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeAlias

from sympy.printing.str import StrPrinter

from modeling import symbolic as sp
from modeling.errors import InputError, quoted
from modeling.formulas.custom_effect import CustomEffect
from modeling.formulas.parser import LONGEST_FORMULA, NAME, FormulaSource

FormulaTable: TypeAlias = "Mapping[str, str | sp.Expr]"


def own_effect(
    *,
    id: str,
    title: str,
    parameters: Mapping[str, str | Mapping[str, Any]],
    tip_body: FormulaTable | None = None,
    gain: FormulaTable | None = None,
    zero: FormulaTable | None = None,
    let: FormulaTable | None = None,
    inputs: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
    advice: str | None = None,
    per_recording: bool = False,
) -> CustomEffect:
    """A custom effect with the keys of an effects file (see `CustomEffect`): one of `tip_body`, `gain`, `zero` given.

    Signals and parameters are symbols by their names (`signals`). Expressions become text, so that the effect can be
    stored in a model file.

    Parameters
    ----------
    id : str
        Its name in results.
    title : str
        Its name for a person.
    parameters : mapping
        Unit by name, or a table: unit, bounds, nominal, search (grid values of a nuisance parameter).
    tip_body : mapping, optional
        Force of the environment on the tool, N, along the world's axes: force_x, force_y, force_z at the point `at` (m)
        along the tip; or its wrench in the tool's axes about the sensor origin: fcx, fcy, tauc, or fcx .. tcz.
    gain : mapping, optional
        By `<row>_<column>`: reading row += formula times the true channel column.
    zero : mapping, optional
        By channel, in its unit: added to the readings last, in any sign convention.
    let : mapping, optional
        Intermediate variables: formulas by name that later ones may use.
    inputs : mapping, optional
        Unit of each further column of the recording, by name.
    constants : mapping, optional
        Numbers with a unit, "0.1 m".
    advice : str, optional
        What to check on the rig.
    per_recording : bool, optional
        Whether its parameters differ between recordings, by default False.

    Returns
    -------
    CustomEffect
        An effect to add to a model, or a candidate of `diagnose`.

    Raises
    ------
    InputError
        Naming key and column, for an invalid definition.

    Examples
    --------
    >>> import truewrench as tw
    >>> temperature, slope = tw.signals("temperature", "slope")
    >>> warming = tw.own_effect(
    ...     id="warming",
    ...     title="zero of fx follows the temperature",
    ...     parameters={"slope": "N/K"},
    ...     zero={"fx": slope * temperature},
    ...     inputs={"temperature": "K"},
    ... )
    >>> warming.id
    'warming'
    """
    given: dict[str, Any] = {"parameters": parameters, "inputs": inputs, "constants": constants, "advice": advice}
    given |= {key: _text(key, table, id) for key, table in (("let", let), ("gain", gain), ("zero", zero))}
    given |= {"tip_body": _text("tip_body", tip_body, id), "per_recording": per_recording}
    table = {"id": id, "title": title} | {key: value for key, value in given.items() if value is not None}
    return CustomEffect.from_data(table, where=id if id.isidentifier() else "effect")


def _text(key: str, table: FormulaTable | None, where: str) -> dict[str, str] | None:
    """Formulas as text."""
    if table is None:
        return None
    return {
        name: formula if isinstance(formula, str) else formula_text(formula, where=f"{where}: {key}.{name}")
        for name, formula in table.items()
    }


def formula_text(expression: sp.Expr | float, *, where: str = "formula") -> str:
    """The text of a formula equal to the expression.

    Functions unknown to formulas print by SymPy's names, which the parser then rejects. Raises InputError for symbols
    whose name is not an identifier, for numbers that are not real and finite, and for anything but an expression.
    """
    remedy = "use text, or SymPy expressions of symbols named by letters, digits and _"
    try:
        formula = sp.sympify(expression, strict=True)
        for atom in formula.atoms():
            if isinstance(atom, sp.Symbol) and not re.fullmatch(NAME, atom.name):
                raise InputError(what=f"the symbol name {quoted(atom.name)} is not valid", where=where, remedy=remedy)
            if not isinstance(atom, sp.Symbol) and not (atom.is_number and atom.is_finite and atom.is_real):
                raise InputError(what=f"{atom} is not a finite real number", where=where, remedy=remedy)
        text = str(_Printer().doprint(formula))
    except (sp.SympifyError, AttributeError, RecursionError):
        raise InputError(what="this expression cannot be written as a formula", where=where, remedy=remedy) from None
    if len(text) > LONGEST_FORMULA:
        raise FormulaSource(text, where).error(
            LONGEST_FORMULA + 1, f"it prints as {len(text)} characters", "divide it into steps"
        )
    return text


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's printer with the function names of formulas and all digits."""

    def _print_Float(self, expr: sp.Float) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_Exp1(self, expr: sp.Expr) -> str:  # noqa: N802
        return "exp(1)"

    def _print_Abs(self, expr: sp.Expr) -> str:  # noqa: N802
        return f"abs({self._print(expr.args[0])})"

    def _print_Max(self, expr: sp.Expr) -> str:  # noqa: N802
        return f"max({self.stringify(expr.args, ', ')})"

    def _print_Min(self, expr: sp.Expr) -> str:  # noqa: N802
        return f"min({self.stringify(expr.args, ', ')})"

    def _print_Pow(self, expr: sp.Expr, rational: bool = False) -> str:  # noqa: N802
        return str(super()._print_Pow(expr, rational)).replace("**", "^")
