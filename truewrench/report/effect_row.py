"""Table row of one candidate effect, as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from diagnosis.verdict.finding import Finding
from estimation.fit import Estimate
from modeling.number_format import (
    FormattedQuantity,
    format_p_value,
    format_percentage,
)
from modeling.space import Space

MAX_SHOWN_PARAMETERS = 6
"""Parameters of an effect shown; the rest is collapsed."""


@dataclass(frozen=True)
class EffectRow:
    """One candidate effect with its numbers as text; `share` is the width of the bar in per cent."""

    finding: Finding
    p_value: str
    removed: str
    share: float
    sizes: tuple[FormattedQuantity, ...]
    more_sizes: tuple[FormattedQuantity, ...]
    detectable: tuple[FormattedQuantity, ...]
    more_detectable: tuple[FormattedQuantity, ...]


def effect_row(finding: Finding, space: Space) -> EffectRow:
    """Row of one effect."""
    units = {p.name: p.unit for p in finding.effect.parameters(space)}
    sizes = _by_signal_to_noise(finding.parameters)
    limits = [FormattedQuantity.of(n, v, units.get(n, ""), digits=2) for n, v in finding.detectable.items()]
    return EffectRow(
        finding=finding,
        p_value=format_p_value(finding.p_value),
        removed=format_percentage(finding.error_removed),
        share=round(100 * min(1.0, max(0.0, finding.error_removed or 0.0)), 1),
        sizes=tuple(sizes[:MAX_SHOWN_PARAMETERS]),
        more_sizes=tuple(sizes[MAX_SHOWN_PARAMETERS:]),
        detectable=tuple(limits[:MAX_SHOWN_PARAMETERS]),
        more_detectable=tuple(limits[MAX_SHOWN_PARAMETERS:]),
    )


def _by_signal_to_noise(parameters: Mapping[str, Estimate]) -> list[FormattedQuantity]:
    """Parameters as text; more than are shown at once in order of |value| / std."""
    found = list(parameters.items())
    if len(found) > MAX_SHOWN_PARAMETERS:
        found.sort(key=lambda pair: -_signal_to_noise(pair[1]))
    return [FormattedQuantity.of(name, e.value, e.unit, e.std) for name, e in found]


def _signal_to_noise(estimate: Estimate) -> float:
    return abs(estimate.value) / estimate.std if isfinite(estimate.std) and estimate.std > 0 else 0.0
