"""Trend and step tests of a quantity over recordings (weighted F test, Bonferroni)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import f_sf
from modeling.number_format import format_number, format_p_value, format_unit
from modeling.significance import LEVELS
from truewrench.surveying.quantity_series import QuantitySeries, quantity_series
from truewrench.surveying.survey_row import SurveyRow

Array = NDArray[np.float64]

MIN_RECORDINGS = 5
"""Recordings needed: a trend or a step has two parameters, and the scatter about it is estimated."""
CHANGE_KINDS = 2
"""Number of kinds of change tested: trend and step."""


class ChangeKind(Enum):
    """Kind of a change."""

    TREND = "trend"
    STEP = "step"


@dataclass(frozen=True, eq=False)
class QuantityChange:
    """A significant change of a quantity over recordings.

    before, after  level at the first and the last of the recordings used
    start, end     their times; of a step, the times of the recordings around it
    p_value        Bonferroni-corrected for both kinds, every location of a step, and the number of series tested
    """

    series: QuantitySeries
    kind: ChangeKind
    before: float
    after: float
    start: datetime
    end: datetime
    p_value: float

    def __str__(self) -> str:
        unit = format_unit(self.series.unit)
        verb = {
            (ChangeKind.TREND, True): "increases",
            (ChangeKind.TREND, False): "decreases",
            (ChangeKind.STEP, True): "steps up",
            (ChangeKind.STEP, False): "steps down",
        }[self.kind, self.after > self.before]
        levels = f"from {format_number(self.before)} to {format_number(self.after)}{' ' + unit if unit else ''}"
        return (
            f"{self.series.name} {verb} {levels} between {self.start:%Y-%m-%d %H:%M} and {self.end:%Y-%m-%d %H:%M} "
            f"(p = {format_p_value(self.p_value)})"
        ).replace("p = <", "p <")


def significant_changes(rows: Sequence[SurveyRow]) -> list[QuantityChange]:
    """Significant changes over the recordings with an adequate model, most significant first."""
    testable = [series for series in quantity_series(rows) if _usable(series).sum() >= MIN_RECORDINGS]
    found = [change for series in testable if (change := significant_change(series, tests=len(testable))) is not None]
    return sorted(found, key=lambda c: c.p_value)


def significant_change(series: QuantitySeries, *, tests: int = 1) -> QuantityChange | None:
    """The trend or step of a series if significant among `tests` series, else None.

    With weights 1/s_i² the chi-square of a constant is X_0, that of a line or a step X_1 with n - 2 degrees of freedom.
    The scatter between recordings may exceed the stds, which are those of one recording's noise alone: so
    F = (X_0 - X_1) / max(1, X_1 / (n - 2)) against F(1, n - 2). The kind with the smaller p-value is returned.
    """
    usable = _usable(series)
    count = int(usable.sum())
    if count < MIN_RECORDINGS:
        return None
    days, value, weight = series.days[usable], series.value[usable], series.std[usable] ** -2
    moments = [m for m, used in zip(series.moments, usable, strict=True) if used]
    found = [_trend(days, value, weight), *(_step(days, value, weight, k) for k in range(1, count))]
    p_values = np.array([1.0 if fit is None else _p_value(value, weight, fit) for fit in found])
    p_values[1:] *= count - 1
    best = int(p_values.argmin())
    p_value, levels = min(1.0, float(p_values[best]) * CHANGE_KINDS * tests), found[best]
    if p_value >= LEVELS.drift_of_survey or levels is None:
        return None
    kind, place = (ChangeKind.STEP, (best - 1, best)) if best else (ChangeKind.TREND, (0, -1))
    start, end = (moments[i] for i in place)
    return QuantityChange(series, kind, float(levels[0]), float(levels[-1]), start, end, p_value)


def _usable(series: QuantitySeries) -> NDArray[np.bool_]:
    return np.asarray(series.trusted & np.isfinite(series.std) & (series.std > 0))


def _trend(days: Array, value: Array, weight: Array) -> Array | None:
    """Weighted regression line at the times, (n,); None where all times are equal."""
    centred = days - np.average(days, weights=weight)
    spread = (weight * centred**2).sum()
    if spread <= 0:
        return None
    return np.asarray(np.average(value, weights=weight) + centred * (weight * centred * value).sum() / spread)


def _step(days: Array, value: Array, weight: Array, place: int) -> Array | None:
    """Weighted means before and from recording `place` on, (n,); None where its time equals that of the one before."""
    if days[place] == days[place - 1]:
        return None
    means = [np.average(value[part], weights=weight[part]) for part in (slice(place), slice(place, None))]
    return np.repeat(means, [place, len(value) - place])


def _p_value(value: Array, weight: Array, levels: Array) -> float:
    freedom = len(value) - 2
    constant = (weight * (value - np.average(value, weights=weight)) ** 2).sum()
    residual = (weight * (value - levels) ** 2).sum()
    return float(f_sf(max(0.0, constant - residual) / max(1.0, residual / freedom), 1, freedom))
