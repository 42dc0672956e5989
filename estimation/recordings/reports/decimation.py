"""Decimation for pictures: the smallest and the largest sample of each interval, so that no peak is lost."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

PIXEL_COLUMNS = 360
"""Width of a panel in pixels."""


def min_max_decimated(x: Array, y: Array, bins: int = PIXEL_COLUMNS) -> tuple[Array, Array]:
    """The smallest and the largest y in each of `bins` equal intervals of samples, in order."""
    if len(y) <= 2 * bins:
        return x, y
    return extremes(x, y, np.linspace(0, len(y), bins + 1).astype(int))


def extremes(x: Array, y: Array, edges: NDArray[np.intp]) -> tuple[Array, Array]:
    """The smallest and the largest y between consecutive indices, in order."""
    parts = [(start, y[start:end]) for start, end in pairwise(edges)]
    index = np.unique([start + i for start, part in parts for i in (int(part.argmin()), int(part.argmax()))])
    return x[index], y[index]
