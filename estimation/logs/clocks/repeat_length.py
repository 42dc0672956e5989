"""Length of repeats, and whether lengths differ as little as those of one motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.logs.log_table import Array

SLIGHT_DIFFERENCE, SLIGHT_SAMPLES = 0.02, 3
"""Share of a repeat, and samples, by which repeats may differ in length and be of one motion still."""

Index = NDArray[np.int64]


def repeat_lengths(repeat: Array) -> Index:
    """Rows of each repeat in a column that counts them."""
    return np.diff(np.concatenate([[0], np.flatnonzero(np.diff(repeat)) + 1, [len(repeat)]])).astype(np.int64)


def differ_slightly(lengths: Index) -> bool:
    """Whether repeats are of different length, but of one motion still."""
    usual = float(np.median(lengths))
    difference = float(np.abs(lengths - usual).max())
    return int(np.ptp(lengths)) > 0 and difference <= slight_difference(usual) < usual / 2


def slight_difference(length: float) -> float:
    """Samples by which repeats of this length may differ."""
    return max(SLIGHT_SAMPLES, SLIGHT_DIFFERENCE * length)
