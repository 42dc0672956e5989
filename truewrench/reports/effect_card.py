"""Card of one effect: sketch, equations, and what each of its parameters is, with its estimate."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from estimation.fit import Fit
from modeling.chain.effect import Effect
from modeling.number_format import NO_VALUE, format_number, format_unit, format_with_std
from modeling.table import Column, Table
from truewrench.effect_description import effect_sketch, parameter_meaning
from truewrench.effect_description.effect_size import size_sentence
from truewrench.effect_description.equation_texts import equation_texts


@dataclass(frozen=True)
class EffectCard:
    """What a reader needs to understand an effect of a fitted model.

    stated     the equation as the catalogue or the user's file states it
    equations  derived ones, as MathML; none where none is short enough to be read
    symbols    sentence on the symbols of these
    table      parameters with meaning, estimate and detection limit
    size       sentence on how much it changes the readings; empty for a recording-specific one
    """

    id: str
    title: str
    stated: str
    advice: str
    sketch: Markup
    equations: tuple[Markup, ...]
    symbols: str
    table: Table
    size: str = ""


def effect_cards(fit: Fit) -> list[EffectCard]:
    """A card for each effect of the fitted model."""
    return [_effect_card(effect, fit) for effect in fit.model.effects]


def _effect_card(effect: Effect, fit: Fit) -> EffectCard:
    derived = equation_texts(effect, fit.model)
    return EffectCard(
        id=effect.id,
        title=effect.title,
        stated=effect.equation,
        advice=effect.advice,
        sketch=sketch_markup(effect),
        equations=tuple(Markup(line) for line in derived.mathml),  # SymPy escapes
        symbols=derived.symbols,
        size=size_sentence(fit, effect.id),
        table=_parameter_table(effect, fit),
    )


def sketch_markup(effect: Effect) -> Markup:
    """The sketch for a page; empty for an effect that a user wrote."""
    return Markup(effect_sketch(effect))  # the sketch is ours


def _parameter_table(effect: Effect, fit: Fit) -> Table:
    """Every parameter of an effect: meaning, estimate and unit."""
    rows = []
    for parameter in effect.parameters(fit.model.space):
        estimate = fit.parameters.get(f"{effect.id}.{parameter.name}")
        size = NO_VALUE if estimate is None else format_with_std(estimate.value, estimate.std)
        if estimate is not None and estimate.std == 0:
            size = f"{format_number(estimate.value)} (fixed)"
        rows.append((parameter.name, parameter_meaning(effect, parameter.name), size, format_unit(parameter.unit)))
    return Table.of((Column("parameter"), Column("what it is"), Column("estimate"), Column("unit")), rows)
