"""Suspects: score tests of the effects that a model lacks, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isclose, isinf, nan
from typing import TYPE_CHECKING

from diagnosis.screening.score_test import ScoreTest, adjusted_p_values
from modeling.number_format import P_VALUE, SHARE, estimate_text, format_number, format_unit
from modeling.parameter import Parameter
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Column, Table, Tabular

if TYPE_CHECKING:
    import pandas as pd

SIZE_COLUMNS = ("parameter", "size", "std", "detectable", "unit")
"""Of the data frame, for the most significant amplitude."""
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
        """Effect, Holm-adjusted p-value, share of the excess chi-square, parameters, size, detectable amount, reason.

        An effect of many parameters removes much without being there: compare it with one of few.
        """
        rows = [
            (
                test.effect.id,
                self.p_values.get(test.effect.id),
                self.share(test),
                self._parameters(test),
                self._amounts(test),
                self.detectable_text(test),
                test.reason,
            )
            for test in self.tests
        ]
        numbers = (Column("p", format=P_VALUE), Column("error removed", format=SHARE), Column("parameters", format="d"))
        return Table.of(("effect", *numbers, "size", "detectable", "not tested, because"), rows)

    def to_frame(self) -> pd.DataFrame:
        """The table with numbers alone: of each effect its most significant amplitude, in its unit.

        `size` is its estimated change from nominal with `std`, `detectable` the change that is detected with 80 %
        power. An amplitude that is nominally infinite (a stiffness, a level of saturation) has no std, and no size
        where it is not significant: it is then above `detectable`.
        """
        import pandas as pd

        frame = self.table.to_frame()
        sizes = pd.DataFrame([self._size(test) for test in self.tests], columns=SIZE_COLUMNS)
        return pd.concat([frame.iloc[:, :4], sizes, frame.iloc[:, -1:]], axis=1)

    def _size(self, test: ScoreTest) -> tuple[str, float, float, float, str]:
        """Name, size, std, detectable change and unit of the most significant amplitude."""
        if not test.amounts:
            return "", nan, nan, nan, ""
        (name, (size, std)), *_ = self._ranked(test)
        parameter = self._qualified(test)[name]
        if isinf(parameter.nominal):
            size, std = size if self._significant(test) else nan, nan
        return _short_name(name), size, std, test.detectable.get(name, nan), parameter.unit

    def remarks(self) -> list[str]:
        """What to do with it."""
        if not self.ids:
            return ["no effect is significant at 1 % (family-wise)"]
        first = f"significant at 1 % (family-wise): {', '.join(self.ids)}; one true effect makes several look so"
        return [first] + [f"{' and '.join(tie)} have the same score here: fit each, and compare" for tie in self.ties]

    @property
    def ties(self) -> list[tuple[str, ...]]:
        """Ids of significant effects whose scores are equal to rounding, as their derivatives are."""
        scores = {t.effect.id: t.statistic for t in self.tests if t.effect.id in self.ids}
        groups = [tuple(n for n, other in scores.items() if isclose(other, score)) for score in scores.values()]
        return list(dict.fromkeys(group for group in groups if len(group) > 1))

    def share(self, test: ScoreTest) -> float | None:
        """Share of the excess chi-square that the effect would remove; None where there is no excess to share."""
        return test.share_of(self.excess)

    def _amounts(self, test: ScoreTest) -> str:
        listed = [self._amount(test, name) for name, _ in self._ranked(test)[:MOST_AMOUNTS]]
        return ", ".join(listed) + ", .." * (len(test.amounts) > MOST_AMOUNTS)

    def _amount(self, test: ScoreTest, name: str) -> str:
        """An amplitude in words.

        One that is nominally infinite is a point of the search, no estimate with a std; where it is not significant it
        is above what is detectable.
        """
        parameter, (size, std) = self._qualified(test)[name], test.amounts[name]
        if not isinf(parameter.nominal):
            return f"{_short_name(name)} = {estimate_text(size, std, parameter.unit)}"
        if self._significant(test):
            return f"{_short_name(name)} = {_number(size, parameter.unit)}"
        if name not in test.detectable:
            return ""
        return f"{_short_name(name)} > {_number(test.detectable[name], parameter.unit)}"

    def detectable_text(self, test: ScoreTest) -> str:
        """The smallest amounts, and the place, time or frequency at which they are."""
        listed, parameters = list(test.detectable.items())[:MOST_AMOUNTS], self._qualified(test)
        searched = test.detectable_at.items()
        amounts, place = (
            ", ".join(f"{_short_name(name)} {_number(v, format_unit(parameters[name].unit))}" for name, v in several)
            for several in (listed, searched)
        )
        return f"{amounts} (at {place})" if amounts and place else amounts

    def _ranked(self, test: ScoreTest) -> list[tuple[str, tuple[float, float]]]:
        """The amplitudes, the most significant first."""
        return sorted(test.amounts.items(), key=lambda a: -abs(a[1][0]) / max(a[1][1], 1e-300))

    def _qualified(self, test: ScoreTest) -> dict[str, Parameter]:
        return {p.name: p for p in test.effect.qualified(self.space)}

    def _parameters(self, test: ScoreTest) -> int:
        return sum(not p.fixed for p in test.effect.parameters(self.space))

    def _significant(self, test: ScoreTest) -> bool:
        return self.p_values.get(test.effect.id, 1.0) < LEVELS.effect


def _short_name(name: str) -> str:
    """The name of a parameter without its effect."""
    return name.split(".", 1)[1]


def _number(value: float, unit: str) -> str:
    return f"{format_number(value, 2)} {format_unit(unit)}".rstrip().replace("−", "-")
