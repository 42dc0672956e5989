"""Table row of one candidate effect, as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from diagnosis.verdict.finding import Finding
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
    sizes = quantities((name, e.value, e.std, e.unit) for name, e in finding.parameters.items())
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


def quantities(estimates: Iterable[tuple[str, float | None, float, str]]) -> list[FormattedQuantity]:
    """Names, values, stds and units as text; more than are shown at once in order of |value| / std."""
    found = list(estimates)
    if len(found) > MAX_SHOWN_PARAMETERS:
        found.sort(key=lambda e: -abs(e[1] or 0.0) / e[2] if e[2] else 0.0)
    return [FormattedQuantity.of(name, value, unit, std) for name, value, std, unit in found]
