"""One suspect in words: its score beside the first one's, the error it removes, its size."""

from __future__ import annotations

from dataclasses import dataclass
from math import isinf
from typing import Any

from diagnosis.screening.score_test import ScoreTest
from diagnosis.screening.suspects import MOST_AMOUNTS, Suspects
from modeling.number_format import format_number, format_p_value, format_percentage, format_unit, format_with_std

MOST_LIKELY_ABSENT = 0.5
"""P-value above which a first guess says nothing: the effect's absence explains its score."""
ALMOST_ALL = 0.9995
"""Share of the error above which it is not told from all of it: noise is part of what an effect fits."""


@dataclass(frozen=True)
class SuspectRow:
    """A suspect with its numbers as text.

    score  percent of the largest score of all
    """

    described: dict[str, Any]
    p_value: str
    removed: str
    score: float
    size: str
    detectable: str
    reason: str

    @classmethod
    def of(cls, test: ScoreTest, described: dict[str, Any], suspects: Suspects) -> SuspectRow:
        """The row of a score test."""
        significant = test.effect.id in suspects.ids
        p_value = suspects.p_values.get(test.effect.id, 1.0)
        largest = max((t.statistic for t in suspects.tests), default=0.0)
        return cls(
            described=described,
            p_value=format_p_value(p_value),
            removed=_share(suspects.share(test)) if significant else "",
            score=round(100 * test.statistic / max(largest, 1e-300), 1) if suspects.ids else 0.0,
            size=_first_guess(test, suspects, significant=significant) if p_value < MOST_LIKELY_ABSENT else "",
            detectable=_detectable(test, suspects),
            reason=test.reason,
        )


def _share(share: float | None) -> str:
    if share is None:
        return ""
    return "> 99.9 %" if share > ALMOST_ALL else format_percentage(share)


def _first_guess(test: ScoreTest, suspects: Suspects, *, significant: bool) -> str:
    """The most significant amplitudes. One that is nominally infinite has no std, and no size but a significant one."""
    known = {p.name: p for p in test.effect.qualified(suspects.space)}
    texts = []
    for name, (value, std) in sorted(test.amounts.items(), key=lambda a: -abs(a[1][0]) / max(a[1][1], 1e-300)):
        infinite = isinf(known[name].nominal)
        if not infinite or significant:
            number = format_number(value, 2) if infinite else format_with_std(value, std)
            texts.append(f"{_own(name)} = {number} {format_unit(known[name].unit)}".rstrip())
    return ", ".join(texts[:MOST_AMOUNTS]) + ", .." * (len(texts) > MOST_AMOUNTS)


def _detectable(test: ScoreTest, suspects: Suspects) -> str:
    units = {p.name: format_unit(p.unit) for p in test.effect.qualified(suspects.space)}
    found = list(test.detectable.items())[:MOST_AMOUNTS]
    return ", ".join(f"{_own(name)} {format_number(value, 2)} {units[name]}".rstrip() for name, value in found)


def _own(name: str) -> str:
    """The name of a parameter without its effect."""
    return name.split(".", 1)[1]
