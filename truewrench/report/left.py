"""Left: what no effect explains, in words."""

from __future__ import annotations

from dataclasses import dataclass

from diagnosis.diagnosis import Diagnosis
from truewrench.plots.number import figures, percentage, unit_text
from truewrench.report.quantity import Quantity


@dataclass(frozen=True)
class Left:
    """What no effect explains, in words."""

    where: str
    looks_like: tuple[str, ...]
    share: str
    sizes: tuple[Quantity, ...]


def left_of(diagnosis: Diagnosis) -> Left | None:
    """Where the remainder lives, and what it looks like."""
    remainder = diagnosis.remainder
    if remainder is None:
        return None
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    known = {c: v for c, v in remainder.explainable_rms.items() if v is not None}
    sizes = [Quantity(c, figures(v), unit_text(units[c])) for c, v in known.items()]
    return Left(remainder.where, remainder.looks_like, percentage(remainder.share), tuple(sizes))
