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
LOOK = 5
"""Steps after which ascents are looked at."""
CHUNK = 5000
"""Points that one call of a compiled function takes: enough to make its overhead small, few enough to share out."""


@dataclass(frozen=True, kw_only=True)
class Patience:
    """How long ascents go on: for so many steps, or until they have gained less than `still` k in the last `LOOK`.

    promise   those end too that are not at the largest F of all even after so many times what they gained of late;
              infinity lets all of them go on
    """

    steps: int
    still: float
    promise: float = np.inf

    def goes_on(self, value: Array, gained: Array, largest: float, size: int) -> NDArray[np.bool_]:
        """Which ascents (N,) do, of F and what was gained of late."""
        going = gained > self.still * size
        return going if np.isinf(self.promise) else going & (value + self.promise * gained > largest)


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


def ascended(function: DualFunction, peaks: Peaks, dual: Dual, patience: Patience) -> Peaks:
    """Projected gradient ascent from each, with the step lengths of Barzilai and Borwein (1988), never downwards."""
    climb = Climb.begun(function, peaks, dual)
    points, value = climb.points.copy(), climb.value.copy()
    going, before = np.arange(len(value)), climb.value
    for number in range(1, patience.steps + 1):
        climb = climb.moved(function, dual)
        if number % LOOK and number < patience.steps:
            continue
        points[going], value[going] = climb.points, climb.value
        on = patience.goes_on(climb.value, climb.value - before, float(value.max()), function.size)
        if not on.any():
            break
        climb, going = climb.chosen(on), going[on]
        before = climb.value
    return at_best_vertex(function, points, dual)


@dataclass(frozen=True, eq=False)
class Climb:
    """Ascents on their way: points of the cube (N, 2n), ddq (N, n), F (N,), its slope (N, 2n) and step lengths (N,)."""

    points: Array
    ddq: Array
    value: Array
    slope: Array
    step: Array

    @classmethod
    def begun(cls, function: DualFunction, peaks: Peaks, dual: Dual) -> Climb:
        """At the points of the peaks, whose ddq it keeps."""
        value, slope = function.slopes(peaks.points, peaks.ddq, dual)
        return cls(peaks.points, peaks.ddq, value, slope, FIRST_STEP / _largest(slope))

    def chosen(self, which: NDArray[np.bool_]) -> Climb:
        """Those of a mask."""
        return Climb(*(part[which] for part in (self.points, self.ddq, self.value, self.slope, self.step)))

    def moved(self, function: DualFunction, dual: Dual) -> Climb:
        """One step on."""
        tried = np.clip(self.points + self.step[:, None] * self.slope, -1, 1)
        value, slope = function.slopes(tried, self.ddq, dual)
        better = value > self.value
        longer = _curvature_step(tried - self.points, slope - self.slope)
        longer = np.clip(longer, self.step / 2, LONGEST_STEP / _largest(slope))
        return Climb(
            np.where(better[:, None], tried, self.points),
            self.ddq,
            np.where(better, value, self.value),
            np.where(better[:, None], slope, self.slope),
            np.where(better, longer, SHRINK * self.step),
        )


def search(
    function: DualFunction,
    dual: Dual,
    points: Array,
    *,
    keep: int,
    patience: Patience,
    executor: Executor | None = None,
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
    found = run(ascended, [function] * count, chunks, [dual] * count, [patience] * count)
    return reduce(Peaks.joined, found)


def _chunks(count: int) -> list[slice]:
    return [slice(i, i + CHUNK) for i in range(0, count, CHUNK)]


def _largest(slope: Array) -> Array:
    return np.asarray(np.maximum(np.abs(slope).max(axis=1), 1e-9))


def _curvature_step(move: Array, change: Array) -> Array:
    """|s's / s'y| of each row."""
    along = np.abs((move * change).sum(axis=1))
    return np.asarray((move**2).sum(axis=1) / np.maximum(along, 1e-14))
