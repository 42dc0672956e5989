"""Hints for formulas of a custom effect: names that a recording has, the unit that a parameter should have."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping

from diagnosis.study import Study
from estimation.model_signals import model_signals
from modeling.errors import InputError, quoted, suggestion
from modeling.formulas.custom_effects.vocabulary import signal_units, tip_units
from modeling.formulas.functions import FORMULA_FUNCTIONS
from modeling.formulas.units import dimension
from modeling.number_format import format_unit

NAME = re.compile(r"(?<![\w.])[A-Za-z][A-Za-z0-9_]*(?![\w.(])")
"""A name in a formula, other than a function's."""
PLAIN = re.compile(r"(?!.*__)[\w\s+\-*/^().,]*", re.DOTALL)
"""A formula of names, numbers and signs; what else there is the parser refuses."""


def known_signals(study: Study) -> dict[str, str]:
    """Unit of each signal that formulas on these recordings may use, as the help lists them."""
    present = model_signals(study.fit.recordings[0])
    return {name: unit for name, unit in signal_units(study.model.space).items() if name in present}


def require_known_names(formulas: Mapping[str, str], own: Collection[str], study: Study) -> None:
    """InputError for a name that is neither the form's own nor in the help for this kind of recording."""
    helped = (*own, *known_signals(study), *tip_units(study.model.space), *study.fit.recordings[0].auxiliary)
    known = {*helped, *FORMULA_FUNCTIONS, "pi"}
    for target, formula in formulas.items():
        for name in NAME.findall(formula) if PLAIN.fullmatch(formula) else ():
            if name not in known:
                what = f"{quoted(name)} is not a known name for these recordings"
                raise InputError(what=what, where=target, remedy=suggestion(name, helped))


def unit_hint(error: InputError, parameters: Mapping[str, str], accepted: Callable[[dict[str, str]], bool]) -> str:
    """The unit that one parameter should have instead, if that alone mends a unit error; else empty.

    `accepted` says whether the form is right with other units of its parameters. A parameter that enters linearly
    should have its unit times the expected over the found one.
    """
    match = re.search(r"its unit is (.+), expected (.+)$", error.what)
    if match is None:
        return ""
    try:
        found, expected = (dimension(unit) for unit in match.groups())
        units = {name: str(dimension(unit) * expected / found) for name, unit in parameters.items()}
    except InputError:
        return ""
    mended = [name for name, unit in units.items() if accepted({**parameters, name: unit})]
    return f"{mended[0]} should be in {format_unit(units[mended[0]])}" if len(mended) == 1 else ""
