"""Channel faults: a channel that clips at its range, or that stops for a while; told from coarse resolution."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

CLIPPED_SHARE = 0.01
NEIGHBOURS = 10
CLIPPED_RATIO = 10.0
"""Repeated rows at the extreme value, over those at a usual one of the next levels. A slow signal that turns within its
resolution stays at its last level for sqrt(1), at the next ones for sqrt(k) - sqrt(k - 1): a ratio of 5 over ten."""
LONGEST_STOP, LEAST_STOP = 0.02, 25
"""Share of the rows, and rows, from which a channel that keeps its value has stopped."""
STOP_RATIO = 50.0
"""Length of a stop over that of a usual hold; a slow signal turns within a hundredth of its range for 30 holds."""


def clipped_rows(column: Array) -> tuple[float, int] | None:
    """The extreme value at which a channel (n,) clips, and its rows there; None if it does not."""
    for extreme in (float(column.min()), float(column.max())):
        count = int((column == extreme).sum())
        if extreme == 0.0 or count - 1 <= max(CLIPPED_SHARE * len(column), 3):
            continue
        levels, counts = np.unique(column, return_counts=True)
        others = counts[levels != extreme]
        others = others[:NEIGHBOURS] if extreme == levels[0] else others[-NEIGHBOURS:]
        if count - 1 > CLIPPED_RATIO * (float(np.median(others)) - 1 if len(others) else 0.0):
            return extreme, count
    return None


def longest_stop(column: Array) -> tuple[int, int] | None:
    """First row and length of the longest stop of a channel (n,) that changes otherwise; None without one."""
    starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    lengths = np.diff(np.append(starts, len(column)))
    longest = int(np.argmax(lengths))
    least = max(LONGEST_STOP * len(column), LEAST_STOP, STOP_RATIO * float(np.median(lengths)))
    if len(lengths) < 3 or lengths[longest] < least:
        return None
    return int(starts[longest]), int(lengths[longest])
