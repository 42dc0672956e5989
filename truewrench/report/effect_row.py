"""Table row of one candidate effect, as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from diagnosis.verdict.finding import Finding
from estimation.fit import Estimate
from modeling.space import Space
from truewrench.text.number_format import (
    FormattedQuantity,
    format_number,
    format_p_value,
    format_percentage,
    format_unit,
    format_with_std,
)

MAX_SHOWN_PARAMETERS = 6
"""Parameters of an effect shown; the rest is collapsed."""


@dataclass(frozen=True)
class EffectRow:
    """One candidate effect as text; `share` is the width of the bar in per cent."""

    id: str
    title: str
    equation: str
    advice: str
    verdict: str
    words: str
    p_value: str
    removed: str
    share: float
    sizes: tuple[FormattedQuantity, ...]
    more_sizes: tuple[FormattedQuantity, ...]
    detectable: tuple[FormattedQuantity, ...]
    more_detectable: tuple[FormattedQuantity, ...]
    confusable_with: tuple[str, ...]
    reason: str


def effect_row(finding: Finding, space: Space) -> EffectRow:
    """Row of one effect."""
    effect = finding.effect
    units = {p.name: p.unit for p in effect.parameters(space)}
    sizes = _by_signal_to_noise(finding.parameters)
    limits = [
        FormattedQuantity(n, format_number(v, 2), format_unit(units.get(n, ""))) for n, v in finding.detectable.items()
    ]
    return EffectRow(
        id=effect.id,
        title=effect.title,
        equation=effect.equation,
        advice=effect.advice,
        verdict=finding.verdict.value,
        words=finding.verdict.value.replace("_", " "),
        p_value=format_p_value(finding.p_value),
        removed=format_percentage(finding.error_removed),
        share=round(100 * min(1.0, max(0.0, finding.error_removed or 0.0)), 1),
        sizes=tuple(sizes[:MAX_SHOWN_PARAMETERS]),
        more_sizes=tuple(sizes[MAX_SHOWN_PARAMETERS:]),
        detectable=tuple(limits[:MAX_SHOWN_PARAMETERS]),
        more_detectable=tuple(limits[MAX_SHOWN_PARAMETERS:]),
        confusable_with=finding.confusable_with,
        reason=finding.reason,
    )


def _by_signal_to_noise(parameters: Mapping[str, Estimate]) -> list[FormattedQuantity]:
    """Parameters as text; more than are shown at once in order of |value| / std."""
    found = list(parameters.items())
    if len(found) > MAX_SHOWN_PARAMETERS:
        found.sort(key=lambda pair: -_signal_to_noise(pair[1]))
    return [FormattedQuantity(name, format_with_std(e.value, e.std), format_unit(e.unit)) for name, e in found]


def _signal_to_noise(estimate: Estimate) -> float:
    return abs(estimate.value) / estimate.std if isfinite(estimate.std) and estimate.std > 0 else 0.0
