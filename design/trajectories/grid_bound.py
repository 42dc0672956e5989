"""Guaranteed bounds of a function between grid points, from a bound on its second derivative."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from design.trajectories.trajectory import Array

TIGHTNESS = 2e-5
"""Target margin as a share of the half range: five times tighter than `TrajectorySeries.enclosure` guarantees."""
COARSE_POINTS = 32
"""Points between two breaks of the coarse grid, which only determines the spacing of the fine one."""
MOST_POINTS = 100_000
"""Points of the finest grid, so that a nearly constant function takes a tenth of a second at most."""


PIECE_INSET = 1e-12
"""Inset of a piece's first and last point, as a share of the duration, so that they are on its side of a jump."""


def grid_bound(values: Callable[[Array], Array], second: Array, breaks: Array) -> tuple[Array, Array]:
    """Bounds low (n,) and high (n,) of functions `values` (time (N,) to (N, n)) between the first and the last break.

    Between two points h apart a function differs from its chord by at most h²/8 times the largest absolute value of
    its second derivative there (the error of linear interpolation), and the chord stays between its ends. `second`
    (P, n) bounds that derivative in each of the P pieces between the breaks (P + 1,), where the functions and their
    derivatives may jump; the grid is as fine in each piece as makes the margin `TIGHTNESS` of the half range.
    """
    coarse = values(_grid(breaks, np.full(len(second), COARSE_POINTS)))
    half = (coarse.max(axis=0) - coarse.min(axis=0)) / 2
    squared = np.divide(8 * TIGHTNESS * half, second, out=np.full(second.shape, np.inf), where=second > 0)
    steps = np.maximum(np.sqrt(squared.min(axis=1)), (breaks[-1] - breaks[0]) / MOST_POINTS)
    counts = np.maximum(np.ceil(np.diff(breaks) / steps), 1).astype(int)
    margin = np.repeat((np.diff(breaks) / counts)[:, None] ** 2 / 8 * second, counts + 1, axis=0)
    inside, at_breaks = values(_grid(breaks, counts)), values(breaks)
    low, high = np.vstack([inside - margin, at_breaks]), np.vstack([inside + margin, at_breaks])
    return low.min(axis=0), high.max(axis=0)


def _grid(breaks: Array, counts: Array) -> Array:
    """Times that divide each piece between breaks into a number of equal parts, its ends included."""
    inside = PIECE_INSET * (breaks[-1] - breaks[0])
    pieces = zip(breaks[:-1] + inside, breaks[1:] - inside, counts + 1, strict=True)
    return np.concatenate([np.linspace(first, last, count) for first, last, count in pieces])
