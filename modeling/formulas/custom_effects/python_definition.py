"""Custom effects defined in Python, their formulas as text or SymPy expressions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from modeling import symbolic as sp
from modeling.formulas.custom_effects.custom_effect import CustomEffect
from modeling.formulas.printing import formula_text

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
    """A custom effect with the keys of an effects file (see `CustomEffect`), one of `tip_body`, `gain`, `zero` given.

    parameters     unit by name, or a table: unit, bounds, nominal, search (grid values of a nuisance parameter)
    let            intermediate variables: formulas by name that later ones may use
    inputs         unit of each further column of the recording, by name
    constants      numbers with a unit, "0.1 m"

    Signals and parameters are symbols by their names: `tip_x, k = tw.signals("tip_x", "k")`. Expressions become text,
    so that the effect can be stored in a model file.
    Raises InputError, naming key and column, for an invalid definition.
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
