"""Equations of an effect as text for a page, cached on disk: a report then needs no SymPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.compiled.cache import source_digest


@dataclass(frozen=True)
class EquationTexts:
    """Equations as `<math>` elements, and a sentence on their symbols; empty where none is short enough to be read."""

    mathml: tuple[str, ...] = ()
    symbols: str = ""


def equation_texts(effect: Effect, model: WrenchModel) -> EquationTexts:
    """What the effect changes of the readings of this model, derived from its perturbation."""
    alone = replace(model, effects=(effect,))
    return alone.stored(f"equations by {SOURCE}", lambda: _derived(effect, model), _read)


def _derived(effect: Effect, model: WrenchModel) -> Mapping[str, Any]:
    from truewrench.effect_description.effect_equations import effect_equations

    equations = effect_equations(effect, model)
    return {} if equations is None else {"mathml": equations.mathml, "symbols": equations.symbols}


def _read(data: Mapping[str, Any]) -> EquationTexts:
    return EquationTexts(tuple(data["mathml"]), str(data["symbols"])) if data else EquationTexts()


SOURCE = source_digest(Path(__file__).parent)
"""Of the modules that derive and print the equations."""
