"""Search: states of large F, by ascent from many starts in the cube of viable states."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import Dual, DualFunction

Array = NDArray[np.float64]

IN_THE_MIDDLE = 0.2
"""Probability with which a coordinate of a start that is not at its end is zero: F is large standing still, too."""
FIRST_STEP = 0.05
"""Of an ascent, in the cube of half width one."""
LONGEST_STEP = 2.0
"""An ascent cannot go farther than across the cube."""
SHRINK = 0.25
"""Of the step after one that did not go up."""
CHUNK = 2000
"""Points that one call of a compiled function takes: enough to make its overhead small, few enough to share out."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """Points of the cube (N, 2n) with ddq (N, n) and the value of F there (N,)."""

    points: Array
    ddq: Array
    value: Array

    def __len__(self) -> int:
        return len(self.value)

    def chosen(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Peaks:
        """Those of an index or of a mask."""
        return Peaks(self.points[which], self.ddq[which], self.value[which])

    def joined(self, other: Peaks) -> Peaks:
        """These and others."""
        return Peaks(*(np.concatenate([getattr(p, n) for p in (self, other)]) for n in ("points", "ddq", "value")))


def starts(joints: int, count: int, rng: np.random.Generator) -> Array:
    """Random points (count, 2n) of the cube: inside, in its middle planes, on its faces, edges and corners.

    How probable it is that a coordinate is at its end is drawn anew for q and for dq of every start, so that corners
    of all q with any dq are seen about as often as points inside.
    """
    inside = rng.uniform(-1, 1, (count, 2 * joints))
    at_end = rng.random(inside.shape) < np.repeat(rng.random((count, 2)), joints, axis=1)
    middle = rng.random(inside.shape) < IN_THE_MIDDLE
    return np.where(at_end, np.sign(inside), np.where(middle, 0.0, inside))


def at_best_vertex(function: DualFunction, points: Array, dual: Dual) -> Peaks:
    """The points with the vertex of ddq where F is largest."""
    parts = [function.values(points[part], dual) for part in _chunks(len(points))]
    values = np.vstack(parts)
    best = values.argmax(axis=1)
    return Peaks(points, function.viable.vertices[best], values[np.arange(len(values)), best])


def ascended(function: DualFunction, peaks: Peaks, dual: Dual, steps: int) -> Peaks:
    """Projected gradient ascent from each, with the step lengths of Barzilai and Borwein (1988), never downwards."""
    points, (value, slope) = peaks.points, function.slopes(peaks.points, peaks.ddq, dual)
    step = FIRST_STEP / _largest(slope)
    for _ in range(steps):
        tried = np.clip(points + step[:, None] * slope, -1, 1)
        tried_value, tried_slope = function.slopes(tried, peaks.ddq, dual)
        better = tried_value > value
        longer = np.clip(_curvature_step(tried - points, tried_slope - slope), step / 2, LONGEST_STEP / _largest(slope))
        step = np.where(better, longer, SHRINK * step)
        points = np.where(better[:, None], tried, points)
        slope = np.where(better[:, None], tried_slope, slope)
        value = np.where(better, tried_value, value)
    return at_best_vertex(function, points, dual)


def search(
    function: DualFunction, dual: Dual, points: Array, *, keep: int, steps: int, executor: Executor | None = None
) -> Peaks:
    """Ascents from the best points of `keep` groups that the points (N, 2n) fall into in turn.

    The best of all would lie together about a few peaks, and others would be missed.
    """
    first = at_best_vertex(function, points, dual)
    groups = [np.arange(place, len(points), keep) for place in range(min(keep, len(points)))]
    chosen = first.chosen(np.array([group[first.value[group].argmax()] for group in groups]))
    chunks = [chosen.chosen(np.arange(len(chosen))[part]) for part in _chunks(len(chosen))]
    run = map if executor is None else executor.map
    count = len(chunks)
    return reduce(Peaks.joined, run(ascended, [function] * count, chunks, [dual] * count, [steps] * count))


def _chunks(count: int) -> list[slice]:
    return [slice(i, i + CHUNK) for i in range(0, count, CHUNK)]


def _largest(slope: Array) -> Array:
    return np.asarray(np.maximum(np.abs(slope).max(axis=1), 1e-9))


def _curvature_step(move: Array, change: Array) -> Array:
    """|s's / s'y| of each row."""
    along = np.abs((move * change).sum(axis=1))
    return np.asarray((move**2).sum(axis=1) / np.maximum(along, 1e-14))
