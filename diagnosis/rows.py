"""Rows: which of a recording's whitened rows the sensitivity of an effect is judged in."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.noise import Noise
from estimation.whitening import Whitener

Array = NDArray[np.float64]
Index = slice | NDArray[np.intp]


class Rows(Enum):
    """Rows of one recording: none, those of the excited lines, those of the lines between, or all."""

    NONE = "none"
    STEADY = "excited lines"
    REST = "lines between"
    WHOLE = "all"

    def within(self, whitener: Whitener) -> tuple[int, int]:
        """First row and the one after the last, counted within the recording."""
        ends = {
            Rows.NONE: (0, 0),
            Rows.STEADY: (0, whitener.steady_rows),
            Rows.REST: (whitener.steady_rows, whitener.rows),
            Rows.WHOLE: (0, whitener.rows),
        }
        return ends[self]

    def whitened(self, whitener: Whitener, series: Array, *, periodic: bool) -> Array:
        """These rows (r, ...) of a series of one repeat (periodic), or over the whole record, (n, p, ...)."""
        if self is Rows.NONE:
            return np.zeros((0, *series.shape[2:]))
        if periodic:
            if self is Rows.STEADY:
                return whitener.steady(series)
            first, last = self.within(whitener)
            found = np.zeros((last - first, *series.shape[2:]), order="F")
            if self is Rows.WHOLE:
                found[: whitener.steady_rows] = whitener.steady(series)
            return found
        if self is Rows.REST:
            return whitener.rest(series)
        first, last = self.within(whitener)
        return whitener.series(series)[first:last]


Choice = tuple[Rows, ...]
"""Rows of each recording of a fit."""


def index_of(choice: Choice, noise: Sequence[Noise]) -> Index:
    """Where the chosen rows stand among those of all recordings, one after the other."""
    ranges, start = [], 0
    for rows, own in zip(choice, noise, strict=True):
        first, last = rows.within(own.whitener)
        if last > first:
            ranges.append((start + first, start + last))
        start += own.whitener.rows
    if not ranges:
        return slice(0, 0)
    if all(end == begin for (_, end), (begin, _) in pairwise(ranges)):
        return slice(ranges[0][0], ranges[-1][1])
    return np.concatenate([np.arange(first, last) for first, last in ranges])
