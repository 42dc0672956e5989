"""Writing: an effect of one's own in Python, its formulas as text or as SymPy expressions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from modeling import symbolic as sp
from modeling.formula.printing import printed
from modeling.own.formula_effect import FormulaEffect

Written: TypeAlias = "Mapping[str, str | sp.Expr]"


def own_effect(
    *,
    id: str,
    title: str,
    parameters: Mapping[str, str | Mapping[str, Any]],
    tip_body: Written | None = None,
    gain: Written | None = None,
    zero: Written | None = None,
    let: Written | None = None,
    inputs: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
    advice: str | None = None,
    per_recording: bool = False,
) -> FormulaEffect:
    """An effect in the words of an effects file (see `FormulaEffect`), one of `tip_body`, `gain`, `zero` given.

    parameters     unit by name, or a table: unit, bounds, nominal, search (values that are tried and not tested)
    let            formulas by name that later ones may name
    inputs         unit of each column of the recording that is named
    constants      numbers with a unit, "0.1 m"

    Signals and parameters are symbols by their names: `tip_x, k = tw.signals("tip_x", "k")`. Expressions become text,
    so that what is written in Python can be stored in a model like the rest.
    Raises InputError, naming key and column, for whatever is no such effect.
    """
    given: dict[str, Any] = {"parameters": parameters, "inputs": inputs, "constants": constants, "advice": advice}
    given |= {key: _text(key, table, id) for key, table in (("let", let), ("gain", gain), ("zero", zero))}
    given |= {"tip_body": _text("tip_body", tip_body, id), "per_recording": per_recording}
    table = {"id": id, "title": title} | {key: value for key, value in given.items() if value is not None}
    return FormulaEffect.from_data(table, where=id if id.isidentifier() else "effect")


def _text(key: str, table: Written | None, where: str) -> dict[str, str] | None:
    """Formulas as text."""
    if table is None:
        return None
    return {
        name: formula if isinstance(formula, str) else printed(formula, where=f"{where}: {key}.{name}")
        for name, formula in table.items()
    }
