"""Table row of one candidate effect, as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from diagnosis.verdict.finding import Finding
from estimation.fit import Fit
from modeling.chain.effect import Effect
from modeling.number_format import (
    NO_VALUE,
    FormattedQuantity,
    format_number,
    format_p_value,
    format_percentage,
    format_unit,
    format_with_std,
)
from modeling.space import Space
from modeling.table import Column, Table
from truewrench.effect_description import effect_sketch
from truewrench.effect_description.effect_size import size_sentence
from truewrench.effect_description.equation_texts import equation_texts
from truewrench.text.diagnosis_text import EFFECT_VERDICT_LABELS, closest_sentence, finding_sentence

# Card of one effect: sketch, equations, and what each of its parameters is, with its estimate.


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
    """The sketch for a page; empty for an effect without one."""
    return Markup(effect_sketch(effect))  # the sketch is ours


def _parameter_table(effect: Effect, fit: Fit) -> Table:
    """Every parameter of an effect: meaning, estimate and unit."""
    rows = []
    for parameter in effect.parameters(fit.model.space):
        estimate = fit.parameters.get(f"{effect.id}.{parameter.name}")
        size = NO_VALUE if estimate is None else format_with_std(estimate.value, estimate.shown_std)
        if estimate is not None and estimate.std == 0:
            size = f"{format_number(estimate.value)} (fixed)"
        rows.append((parameter.name, parameter.meaning, size, format_unit(parameter.unit)))
    return Table.of((Column("parameter"), Column("what it is"), Column("estimate"), Column("unit")), rows)


MAX_SHOWN_PARAMETERS = 6
"""Parameters of an effect shown; the rest is collapsed."""


@dataclass(frozen=True)
class ConfusableEffect:
    """An effect that explains the recordings as well as another; `why` says how close."""

    id: str
    title: str
    why: str


@dataclass(frozen=True)
class EffectRow:
    """One candidate effect with its numbers as text; `share` is the width of the bar in per cent.

    verdict     in words, and `reason` why, as a sentence
    confusable  effects of which an added one is indistinguishable in these recordings
    closest     how far the closest other effect is, as a sentence, where none is
    """

    finding: Finding
    verdict: str
    reason: str
    sketch: Markup
    confusable: tuple[ConfusableEffect, ...]
    closest: str
    p_value: str
    removed: str
    share: float
    sizes: tuple[FormattedQuantity, ...]
    more_sizes: tuple[FormattedQuantity, ...]
    detectable: tuple[FormattedQuantity, ...]
    more_detectable: tuple[FormattedQuantity, ...]
    detectable_at: tuple[FormattedQuantity, ...]


def effect_row(finding: Finding, space: Space, findings: Sequence[Finding] = ()) -> EffectRow:
    """Row of one effect; the other `findings` say how close those are that it is confusable with."""
    units = {p.name: p.unit for p in finding.effect.parameters(space)}
    sizes = quantities((name, e.value, e.shown_std, e.unit) for name, e in finding.parameters.items())
    limits, place = (
        tuple(FormattedQuantity.of(n, v, units.get(n, ""), digits=2) for n, v in values.items())
        for values in (finding.detectable, finding.detectable_at)
    )
    return EffectRow(
        finding=finding,
        verdict=EFFECT_VERDICT_LABELS[finding.verdict],
        reason=finding_sentence(finding),
        sketch=sketch_markup(finding.effect),
        confusable=tuple(_confusable(f) for f in findings if f.effect.id in finding.confusable_with),
        closest=closest_sentence(finding),
        p_value=format_p_value(finding.p_value),
        removed=format_percentage(finding.error_removed),
        share=round(100 * min(1.0, max(0.0, finding.error_removed or 0.0)), 1),
        sizes=tuple(sizes[:MAX_SHOWN_PARAMETERS]),
        more_sizes=tuple(sizes[MAX_SHOWN_PARAMETERS:]),
        detectable=limits[:MAX_SHOWN_PARAMETERS],
        more_detectable=limits[MAX_SHOWN_PARAMETERS:],
        detectable_at=place,
    )


def _confusable(finding: Finding) -> ConfusableEffect:
    close = finding.reason.partition("(")[2].removesuffix(")")
    return ConfusableEffect(finding.effect.id, finding.effect.title, close)


def quantities(estimates: Iterable[tuple[str, float | None, float, str]]) -> list[FormattedQuantity]:
    """Names, values, stds and units as text; more than are shown at once in order of |value| / std."""
    pairs = list(estimates)
    if len(pairs) > MAX_SHOWN_PARAMETERS:
        pairs.sort(key=lambda e: -abs(e[1] or 0.0) / e[2] if e[2] else 0.0)
    return [FormattedQuantity.of(name, value, unit, std) for name, value, std, unit in pairs]
