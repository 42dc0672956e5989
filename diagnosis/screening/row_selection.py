"""Row sets of a whitened recording: excited lines, non-excited lines, all."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.fit_column_space import RowIndex
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import Whitener

Array = NDArray[np.float64]


class RowSet(Enum):
    """Rows of one recording: none, the excited lines, the non-excited lines between them, or all."""

    NONE = "none"
    EXCITED = "excited lines"
    NON_EXCITED = "non-excited lines"
    WHOLE = "all"

    def within(self, whitener: Whitener) -> tuple[int, int]:
        """First row and the one after the last, within the recording."""
        ends = {
            RowSet.NONE: (0, 0),
            RowSet.EXCITED: (0, whitener.periodic_rows),
            RowSet.NON_EXCITED: (whitener.periodic_rows, whitener.rows),
            RowSet.WHOLE: (0, whitener.rows),
        }
        return ends[self]

    def whitened(self, whitener: Whitener, series: Array, *, periodic: bool) -> Array:
        """These rows (r, ...) of a whitened series (n, p, ...) over one repeat (periodic) or the whole record."""
        if self is RowSet.NONE:
            return np.zeros((0, *series.shape[2:]))
        if periodic:
            if self is RowSet.EXCITED:
                return whitener.steady_state(series)
            first, last = self.within(whitener)
            found = np.zeros((last - first, *series.shape[2:]), order="F")
            if self is RowSet.WHOLE:
                found[: whitener.periodic_rows] = whitener.steady_state(series)
            return found
        if self is RowSet.NON_EXCITED:
            return whitener.non_excited(series)
        first, last = self.within(whitener)
        return whitener.series(series)[first:last]


RowChoice = tuple[RowSet, ...]
"""Row set of each recording of a fit."""
RowRanges = tuple[tuple[int, int], ...]
"""First row and the one after the last of each recording of a fit, counted within it."""


def row_ranges(choice: RowChoice, noise: Sequence[RecordingNoise]) -> RowRanges:
    """The chosen rows of each recording."""
    return tuple(rows.within(own.whitener) for rows, own in zip(choice, noise, strict=True))


def row_index(within: RowRanges, noise: Sequence[RecordingNoise]) -> RowIndex:
    """Indices of these rows of each recording among the concatenated rows of all."""
    ranges, start = [], 0
    for (first, last), own in zip(within, noise, strict=True):
        if last > first:
            ranges.append((start + first, start + last))
        start += own.whitener.rows
    if not ranges:
        return slice(0, 0)
    if all(end == begin for (_, end), (begin, _) in pairwise(ranges)):
        return slice(ranges[0][0], ranges[-1][1])
    return np.concatenate([np.arange(first, last) for first, last in ranges])
