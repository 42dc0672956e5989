"""Change: what became of a quantity over the recordings: a trend or a step, if it is more than scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f

from diagnosis.price import SIGNIFICANCE
from truewrench.plots.number import figures, probability, unit_text
from truewrench.surveying.row import Row
from truewrench.surveying.series import Series, series_of

Array = NDArray[np.float64]

LEAST = 5
"""Recordings that a change takes: a line or a step has two levels, and the scatter about it has to be seen."""
WAYS = 2
"""Kinds of change that are looked for."""


class Kind(Enum):
    """How a quantity changes."""

    TREND = "trend"
    STEP = "step"


@dataclass(frozen=True, eq=False)
class Change:
    """A significant change of a series.

    before, after  its level at the first and the last of the recordings used
    start, end     the times of those; of a step, the recordings between which it lies
    p_value        corrected for both kinds, every place of a step, and the number of series looked at
    """

    series: Series
    kind: Kind
    before: float
    after: float
    start: datetime
    end: datetime
    p_value: float

    def __str__(self) -> str:
        unit = unit_text(self.series.unit)
        verb = {
            (Kind.TREND, True): "grows",
            (Kind.TREND, False): "falls",
            (Kind.STEP, True): "steps up",
            (Kind.STEP, False): "steps down",
        }[self.kind, self.after > self.before]
        levels = f"from {figures(self.before)} to {figures(self.after)}{' ' + unit if unit else ''}"
        return (
            f"{self.series.name} {verb} {levels} between {self.start:%Y-%m-%d %H:%M} and {self.end:%Y-%m-%d %H:%M} "
            f"(p = {probability(self.p_value)})"
        ).replace("p = <", "p <")


def changes_of(rows: Sequence[Row]) -> list[Change]:
    """The significant changes over the recordings that were explained, the most significant first."""
    every = [series for series in series_of(rows) if _usable(series).sum() >= LEAST]
    found = [change for series in every if (change := change_of(series, tests=len(every))) is not None]
    return sorted(found, key=lambda c: c.p_value)


def change_of(series: Series, *, tests: int = 1) -> Change | None:
    """The trend or step of a series if one is significant among so many series, else None.

    With weights 1/s_i² a constant leaves the chi-square X_0, a line or a step X_1 with n - 2 degrees of freedom. The
    scatter from one recording to the next may exceed the stds, which count one recording's noise alone: so
    F = (X_0 - X_1) / max(1, X_1 / (n - 2)) against F(1, n - 2). The kind with the smaller p-value is taken.
    """
    usable = _usable(series)
    count = int(usable.sum())
    if count < LEAST:
        return None
    days, value, weight = series.days[usable], series.value[usable], series.std[usable] ** -2
    moments = [m for m, used in zip(series.moments, usable, strict=True) if used]
    found = [_trend(days, value, weight), *(_step(days, value, weight, k) for k in range(1, count))]
    p_values = np.array([1.0 if fit is None else _p_value(value, weight, fit) for fit in found])
    p_values[1:] *= count - 1
    best = int(p_values.argmin())
    p_value, levels = min(1.0, float(p_values[best]) * WAYS * tests), found[best]
    if p_value >= SIGNIFICANCE or levels is None:
        return None
    kind, place = (Kind.STEP, (best - 1, best)) if best else (Kind.TREND, (0, -1))
    start, end = (moments[i] for i in place)
    return Change(series, kind, float(levels[0]), float(levels[-1]), start, end, p_value)


def _usable(series: Series) -> NDArray[np.bool_]:
    return np.asarray(series.trusted & np.isfinite(series.std) & (series.std > 0))


def _trend(days: Array, value: Array, weight: Array) -> Array | None:
    """The weighted line at the times, (n,); None where all are one time."""
    centred = days - np.average(days, weights=weight)
    spread = (weight * centred**2).sum()
    if spread <= 0:
        return None
    return np.asarray(np.average(value, weights=weight) + centred * (weight * centred * value).sum() / spread)


def _step(days: Array, value: Array, weight: Array, place: int) -> Array | None:
    """The weighted means before and from a recording on, (n,); None where its time is that of the one before it."""
    if days[place] == days[place - 1]:
        return None
    means = [np.average(value[part], weights=weight[part]) for part in (slice(place), slice(place, None))]
    return np.repeat(means, [place, len(value) - place])


def _p_value(value: Array, weight: Array, levels: Array) -> float:
    freedom = len(value) - 2
    constant = (weight * (value - np.average(value, weights=weight)) ** 2).sum()
    left = (weight * (value - levels) ** 2).sum()
    return float(f.sf(max(0.0, constant - left) / max(1.0, left / freedom), 1, freedom))
