"""Effect row: what is said of one effect of the catalogue, as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from diagnosis.finding import Finding
from estimation.fit import Estimate
from modeling.space import Space
from truewrench.plots.number import figures, percentage, probability, unit_text, with_std
from truewrench.report.quantity import Quantity

SIZES = 6
"""Parameters of an effect shown at once; the rest unfolds."""


@dataclass(frozen=True)
class EffectRow:
    """One effect of the catalogue, as the table shows it; `share` is a width in per cent."""

    id: str
    title: str
    equation: str
    advice: str
    verdict: str
    words: str
    p_value: str
    removed: str
    share: float
    sizes: tuple[Quantity, ...]
    more_sizes: tuple[Quantity, ...]
    detectable: tuple[Quantity, ...]
    more_detectable: tuple[Quantity, ...]
    confusable_with: tuple[str, ...]
    reason: str


def effect_row(finding: Finding, space: Space) -> EffectRow:
    """What is said of one effect, as text."""
    effect = finding.effect
    units = {p.name: p.unit for p in effect.parameters(space)}
    sizes = _most_certain(finding.parameters)
    limits = [Quantity(n, figures(v, 2), unit_text(units.get(n, ""))) for n, v in finding.detectable.items()]
    return EffectRow(
        id=effect.id,
        title=effect.title,
        equation=effect.equation,
        advice=effect.advice,
        verdict=finding.verdict.value,
        words=finding.verdict.value.replace("_", " "),
        p_value=probability(finding.p_value),
        removed=percentage(finding.error_removed),
        share=round(100 * min(1.0, max(0.0, finding.error_removed or 0.0)), 1),
        sizes=tuple(sizes[:SIZES]),
        more_sizes=tuple(sizes[SIZES:]),
        detectable=tuple(limits[:SIZES]),
        more_detectable=tuple(limits[SIZES:]),
        confusable_with=finding.confusable_with,
        reason=finding.reason,
    )


def _most_certain(parameters: Mapping[str, Estimate]) -> list[Quantity]:
    """Parameters as text; of many, those that stand out most from their std first."""
    found = list(parameters.items())
    if len(found) > SIZES:
        found.sort(key=lambda pair: -_certainty(pair[1]))
    return [Quantity(name, with_std(e.value, e.std), unit_text(e.unit)) for name, e in found]


def _certainty(estimate: Estimate) -> float:
    return abs(estimate.value) / estimate.std if isfinite(estimate.std) and estimate.std > 0 else 0.0
