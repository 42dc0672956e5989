"""Distinction: what a designed motion says of rival models, and how often they are still mistaken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.discrimination.pair import CONFUSABLE, SEPARATED, Pair, Verdict
from design.discrimination.search import Round
from design.discrimination.setting import Setting
from design.limit_use import LimitUse
from design.motion.series import Motion


@dataclass(frozen=True, eq=False, kw_only=True)
class Distinction:
    """A motion designed for telling rival models apart, and how far it does.

    motion     within the limits at every instant; None when no motion separates any of them
    pairs      the model given with each of its rivals
    runs       of the motion, to which the lambdas belong
    reference  what `before` is along, in words
    rounds     of the search; the best one's motion is taken
    """

    setting: Setting
    motion: Motion | None
    pairs: tuple[Pair, ...]
    runs: int
    reference: str
    rounds: tuple[Round, ...]

    @property
    def verdict(self) -> Verdict:
        """That of the pair that is told apart worst."""
        return max((pair.verdict for pair in self.pairs), key=list(Verdict).index)

    @property
    def limit_use(self) -> LimitUse | None:
        """How much of each limit the motion uses."""
        return None if self.motion is None else self.setting.use(self.motion)

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite, or None."""
        motion, use = self.motion, self.limit_use
        return {
            "verdict": self.verdict.name.lower(),
            "pairs": [pair.to_data() for pair in self.pairs],
            "runs": self.runs,
            "samples": self.setting.samples,
            "period": self.setting.series.duration,
            "before": self.reference,
            "coefficients": None if motion is None else motion.coefficients.tolist(),
            "worst_limit_use": None if use is None else use.to_data(),
            "rounds": [found.smallest for found in self.rounds],
        }

    def rows(self) -> list[tuple[str, ...]]:
        """Truth, rival, lambda and chance of a mistake before and after, runs for 5 % and 1 % mistakes, as text."""
        rows = []
        for pair in self.pairs:
            for direction in pair.directions:
                chances = [_share(None if direction.imitated else pair.chance(x)) for x in (pair.before, pair.after)]
                found = "imitated exactly" if direction.imitated else f"{direction.after:.4g}"
                runs = [_count(None if direction.imitated else pair.runs_for(x)) for x in (CONFUSABLE, SEPARATED)]
                rows.append((direction.truth, direction.rival, f"{direction.before:.4g}", found, *chances, *runs))
        return rows

    def __str__(self) -> str:
        heads = ("true", "imitated by", "lambda before", "after", "mistaken before", "after", "runs for 5 %", "1 %")
        table = [heads, *self.rows()]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in table]
        lines += [f"{pair.names[0]} or {pair.names[1]}: {_said(pair)}" for pair in self.pairs]
        lines.append(f"lambda in {self.runs} run{'s' * (self.runs > 1)} of the motion; before: {self.reference}")
        if self.limit_use is not None:
            lines.append(self.limit_use.sentence())
        return "\n".join(lines)


def _said(pair: Pair) -> str:
    if pair.verdict is Verdict.NEVER:
        return f"{pair.verdict.value}; the simpler one is held"
    said = pair.verdict.value + ("; one contains the other, the simpler one is held unless it fails" * pair.nested)
    runs = pair.runs_for(SEPARATED)
    return said if pair.verdict is Verdict.SEPARATED else f"{said} ({_count(runs)} for 1 % mistakes)"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _count(value: int | None) -> str:
    return "-" if value is None else f"{value}"
