"""Time series of one quantity over recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from truewrench.surveying.diagnosis_outcome import DiagnosisOutcome, StoredEstimate
from truewrench.surveying.recording_time import TimeSource
from truewrench.surveying.survey_row import SurveyRow

Array = NDArray[np.float64]

ADEQUATE_VERDICTS = ("nothing_missing", "explained")
"""Verdicts of an adequate model, whose stds are the whole uncertainty; with others there is systematic error too."""
DAY = 86400.0


@dataclass(frozen=True, eq=False)
class QuantitySeries:
    """One quantity over the times of the recordings, in time order.

    name, unit  such as `viscous_drag.c` and `N s/m`, or `m` and `kg`
    effect      id of its effect, empty for tool parameters
    moments     n local times
    value, std  (n,), in `unit`; the std inf where it is not identifiable
    trusted     (n,) whether the model was adequate, so that the std is the whole uncertainty
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


def rows_in_time_order(rows: Sequence[SurveyRow]) -> list[SurveyRow]:
    """Rows whose time is of the most frequent source, in time order; equal times in the given order.

    Times of different sources are not compared: copying a file changes its modification time.
    """
    sources = Counter(row.time.source for row in rows if row.time is not None)
    chosen = max(TimeSource, key=lambda source: sources[source])  # on a tie the file name
    return sorted((r for r in rows if r.time is not None and r.time.source is chosen), key=lambda row: row.moment)


def quantity_series(rows: Sequence[SurveyRow]) -> list[QuantitySeries]:
    """Quantities of at least two recordings: effects' parameters first, those of most recordings first.

    Parameters of a tool that is not known are left out. A recording given twice, or a copy of it, is one measurement.
    """
    measured: dict[DiagnosisOutcome, SurveyRow] = {}
    for row in rows_in_time_order(rows):
        measured.setdefault(replace(row.outcome, seconds=None), row)
    found: dict[tuple[str, str, str], list[tuple[SurveyRow, StoredEstimate]]] = {}
    for row in measured.values():
        tool = () if row.outcome.tool_unknown else row.outcome.parameters
        for size in (*row.outcome.sizes, *tool):
            if size.value is not None:
                found.setdefault((size.effect, size.parameter, size.unit), []).append((row, size))
    several = sorted((pairs for pairs in found.values() if len(pairs) > 1), key=lambda p: (not p[0][1].effect, -len(p)))
    return [_series(pairs) for pairs in several]


def _series(pairs: Sequence[tuple[SurveyRow, StoredEstimate]]) -> QuantitySeries:
    first = pairs[0][1]
    return QuantitySeries(
        name=first.name,
        unit=first.unit,
        effect=first.effect,
        moments=tuple(row.moment for row, _ in pairs),
        value=np.array([size.value for _, size in pairs], dtype=np.float64),
        std=np.array([np.inf if size.std is None else size.std for _, size in pairs]),
        trusted=np.array([row.outcome.verdict in ADEQUATE_VERDICTS for row, _ in pairs]),
    )
