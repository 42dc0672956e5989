"""Suspects: score tests of the effects that a model lacks, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isclose

from diagnosis.screening.score_test import ScoreTest, adjusted_p_values
from modeling.number_format import P_VALUE, SHARE, estimate_text, format_number, format_unit
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Column, Table, Tabular

MOST_AMOUNTS = 2
"""Amplitudes of an effect that a row lists, the most significant first."""


@dataclass(frozen=True, eq=False)
class Suspects(Tabular):
    """Score tests of candidate effects given a fit.

    The significant ones come first, that which removes most error first: p-values of strong effects rank them by how
    many parameters they have, and how precisely the noise is known.

    A score test estimates an effect's amplitudes linearly, without a refit: its size is a first guess.

    excess  whitened chi-square of the fit above its expectation under noise alone; None where the noise is estimated
            from the residual, and where the residual is consistent with the noise: there is no error to remove
    """

    tests: tuple[ScoreTest, ...]
    space: Space
    excess: float | None

    @classmethod
    def of(cls, tests: Sequence[ScoreTest], space: Space, excess: float | None) -> Suspects:
        """The tests in order."""
        adjusted = adjusted_p_values(tests)
        first = [t for t in tests if adjusted.get(t.effect.id, 1.0) < LEVELS.effect]
        others = [t for t in tests if t not in first]
        return cls((*sorted(first, key=lambda t: -t.statistic), *others), space, excess)

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of the significant effects, family-wise at 1 %, that which removes most error first."""
        return tuple(t.effect.id for t in self.tests if self.p_values.get(t.effect.id, 1.0) < LEVELS.effect)

    @cached_property
    def p_values(self) -> dict[str, float]:
        """Holm-adjusted p-value of each effect that was tested, by id."""
        return adjusted_p_values(self.tests)

    @property
    def table(self) -> Table:
        """Effect, Holm-adjusted p-value, share of the excess chi-square it removes, size, detectable amount, reason."""
        rows = [
            (
                test.effect.id,
                self.p_values.get(test.effect.id),
                self.share(test),
                self._amounts(test),
                self._detectable(test),
                test.reason,
            )
            for test in self.tests
        ]
        numbers = (Column("p", format=P_VALUE), Column("error removed", format=SHARE))
        return Table.of(("effect", *numbers, "size", "detectable", "not tested, because"), rows)

    def remarks(self) -> list[str]:
        """What to do with it."""
        if not self.ids:
            return ["no effect is significant at 1 % (family-wise)"]
        found = [f"significant at 1 % (family-wise): {', '.join(self.ids)}; one true effect makes several look so"]
        return found + [f"{' and '.join(tie)} have the same score here: fit each, and compare" for tie in self.ties]

    @property
    def ties(self) -> list[tuple[str, ...]]:
        """Ids of significant effects whose scores are equal to rounding, as their derivatives are."""
        scores = {t.effect.id: t.statistic for t in self.tests if t.effect.id in self.ids}
        groups = [tuple(n for n, other in scores.items() if isclose(other, score)) for score in scores.values()]
        return list(dict.fromkeys(group for group in groups if len(group) > 1))

    def share(self, test: ScoreTest) -> float | None:
        """Share of the excess chi-square that the effect would remove; None where there is no excess to share."""
        return min(1.0, test.statistic / self.excess) if self.excess and test.excited else None

    def _amounts(self, test: ScoreTest) -> str:
        units = {p.name: p.unit for p in test.effect.qualified(self.space)}
        ranked = sorted(test.amounts.items(), key=lambda a: -abs(a[1][0]) / max(a[1][1], 1e-300))[:MOST_AMOUNTS]
        found = [f"{n.split('.', 1)[1]} = {estimate_text(*v, units[n])}" for n, v in ranked]
        return ", ".join(found) + ", .." * (len(test.amounts) > MOST_AMOUNTS)

    def _detectable(self, test: ScoreTest) -> str:
        units = {p.name: p.unit for p in test.effect.qualified(self.space)}
        found = list(test.detectable.items())[:MOST_AMOUNTS]
        texts = (f"{n.split('.', 1)[1]} {format_number(v, 2)} {format_unit(units[n])}".rstrip() for n, v in found)
        return ", ".join(texts).replace("−", "-")
