"""Names of the initial values given to a fit."""

from __future__ import annotations

from collections.abc import Iterable

from modeling.chain.model import WrenchModel
from modeling.errors import InputError, quoted, suggestion
from modeling.parameter import Parameter


def require_known_start(start: Iterable[str], model: WrenchModel, unknowns: Iterable[Parameter]) -> None:
    """Raise InputError for the first initial value of no unknown; biases of other recordings (`bias_fx@name`) pass."""
    known = [p.name for p in unknowns]
    biases = {p.name for p in model.biases}
    for name in start:
        label, _, recording = name.partition("@")
        if name not in known and not (recording and label in biases):
            what = f"no parameter is called {quoted(name)}"
            raise InputError(what=what, where="start", remedy=suggestion(name, known))
