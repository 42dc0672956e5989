"""Envelope: a long series as the few points that look the same on the page."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BINS = 360
"""Columns of pixels that a panel is worth."""


def envelope(x: Array, y: Array, bins: int = BINS) -> tuple[Array, Array]:
    """The smallest and the largest y in each of `bins` equal stretches of samples, in the order they come."""
    if len(y) <= 2 * bins:
        return x, y
    edges = np.linspace(0, len(y), bins + 1).astype(int)
    kept = []
    for start, end in pairwise(edges):
        part = y[start:end]
        kept += sorted({start + int(part.argmin()), start + int(part.argmax())})
    index = np.array(kept)
    return x[index], y[index]


def running_mean(y: Array, length: int) -> Array:
    """The mean over `length` samples about each sample, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(y)])
    index = np.arange(len(y))
    low, high = np.maximum(index - length // 2, 0), np.minimum(index + (length + 1) // 2, len(y))
    return np.asarray((total[high] - total[low]) / (high - low))
