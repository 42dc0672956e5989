"""Series: one quantity over the times of the recordings that have it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from truewrench.surveying.outcome import Size
from truewrench.surveying.recording_time import TimeSource
from truewrench.surveying.row import Row

Array = NDArray[np.float64]

TRUSTED = ("nothing_missing", "explained")
"""Verdicts with which a std says how far a size is off; with others it also carries what is not explained."""
DAY = 86400.0


@dataclass(frozen=True, eq=False)
class Series:
    """One quantity over the recordings' times, in their order.

    name, unit  such as `viscous_drag.c` and `N s/m`, or `m` and `kg`
    effect      that it is of, empty for the tool's own
    moments     n local times
    value, std  (n,), in `unit`; the std inf where the recording does not show it
    trusted     (n,) whether the recording was explained, so that the std is the whole uncertainty
    """

    name: str
    unit: str
    effect: str
    moments: tuple[datetime, ...]
    value: Array
    std: Array
    trusted: NDArray[np.bool_]

    @property
    def days(self) -> Array:
        """Times in days since the first, (n,)."""
        return np.array([(moment - self.moments[0]).total_seconds() / DAY for moment in self.moments])


def dated(rows: Sequence[Row]) -> list[Row]:
    """The rows whose time is of the source that most have, in its order; of one time, in their own.

    Times of different sources are not compared: a copied file is as old as its copy.
    """
    sources = Counter(row.time.source for row in rows if row.time is not None)
    chosen = max(TimeSource, key=lambda source: sources[source])  # of equally many the first, the name
    return sorted((r for r in rows if r.time is not None and r.time.source is chosen), key=_moment)


def series_of(rows: Sequence[Row]) -> list[Series]:
    """Every quantity that at least two recordings have: the effects' first, those of most recordings first."""
    found: dict[tuple[str, str, str], list[tuple[Row, Size]]] = {}
    for row in dated(rows):
        for size in (*row.outcome.sizes, *row.outcome.parameters):
            if size.value is not None:
                found.setdefault((size.effect, size.parameter, size.unit), []).append((row, size))
    several = sorted((pairs for pairs in found.values() if len(pairs) > 1), key=lambda p: (not p[0][1].effect, -len(p)))
    return [_series(pairs) for pairs in several]


def _series(pairs: Sequence[tuple[Row, Size]]) -> Series:
    first = pairs[0][1]
    return Series(
        name=first.name,
        unit=first.unit,
        effect=first.effect,
        moments=tuple(_moment(row) for row, _ in pairs),
        value=np.array([size.value for _, size in pairs], dtype=np.float64),
        std=np.array([np.inf if size.std is None else size.std for _, size in pairs]),
        trusted=np.array([row.outcome.verdict in TRUSTED for row, _ in pairs]),
    )


def _moment(row: Row) -> datetime:
    assert row.time is not None
    return row.time.moment
