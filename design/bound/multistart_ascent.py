"""Largest F over the viable states: projected gradient ascents from many starts, the pricing problem."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import reduce
from typing import Self

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables

Array = NDArray[np.float64]

MIDDLE_PROBABILITY = 0.2
"""Probability that a coordinate of a start is zero if it is not at its end: F is large in static states, too."""
FIRST_STEP = 0.05
"""Of an ascent, in the cube of half width one."""
LONGEST_STEP = 2.0
"""Longest step of an ascent: across the cube."""
STEP_REDUCTION = 0.25
"""Factor of the step length after a step without ascent."""
STEPS_PER_CHECK = 5
"""Steps between checks of the stopping rule."""
POINTS_PER_CALL = 5000
"""Points per call of a compiled function: enough for a small overhead, few enough to distribute over workers."""

STARTS_PER_ASCENT = 4
"""Starts of which the best begins an ascent; with more, the highest maxima attract all ascents and narrow ones are
missed."""


@dataclass(frozen=True, kw_only=True)
class StoppingRule:
    """End of ascents: after `steps`, or at a gain below `gain_tolerance` k in the last `STEPS_PER_CHECK` steps.

    extrapolation  an ascent ends, too, if F plus this multiple of its last gain is below the largest F of all;
                   infinity: no such end
    """

    steps: int
    gain_tolerance: float
    extrapolation: float = np.inf

    def continues(self, value: Array, gained: Array, largest: float, size: int) -> NDArray[np.bool_]:
        """The ascents (N,) that continue, from F and the gain of the last steps."""
        gaining = gained > self.gain_tolerance * size
        return gaining if np.isinf(self.extrapolation) else gaining & (value + self.extrapolation * gained > largest)


EVERY_ASCENT = StoppingRule(steps=50, gain_tolerance=1e-7, extrapolation=20.0)
"""From the fifth step on gains decrease: the remaining gain was less than ten times that of the last five steps in half
a million ascents, and twice that is allowed for."""
REFINED_ASCENTS = 40
"""So many of the best are continued."""
REFINING_ASCENT = StoppingRule(steps=400, gain_tolerance=1e-8, extrapolation=20.0)
"""Of the continued ones: to convergence."""


class AlignedArrays:
    """Base of frozen dataclasses whose fields are arrays with one row for each item."""

    def chosen(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """The items of an index or of a mask."""
        return type(self)(*(values[which] for values in vars(self).values()))

    def joined(self, other: Self) -> Self:
        """These items and others."""
        return type(self)(*map(np.concatenate, zip(vars(self).values(), vars(other).values(), strict=True)))


@dataclass(frozen=True, eq=False)
class LocalMaxima(AlignedArrays):
    """Points of the cube (N, 2n) with ddq (N, n) and the value of F there (N,)."""

    points: Array
    ddq: Array
    value: Array

    def __len__(self) -> int:
        return len(self.value)


def random_points(joints: int, count: int, rng: np.random.Generator) -> Array:
    """Random points (count, 2n) of the cube: inside, in its middle planes, on its faces, edges and corners.

    The probability that a coordinate is at its end is drawn anew for q and for dq of every start, so that corners of
    all q with any dq are about as frequent as interior points.
    """
    inside = rng.uniform(-1, 1, (count, 2 * joints))
    at_end = rng.random(inside.shape) < np.repeat(rng.random((count, 2)), joints, axis=1)
    middle = rng.random(inside.shape) < MIDDLE_PROBABILITY
    return np.where(at_end, np.sign(inside), np.where(middle, 0.0, inside))


def at_best_vertex(function: DualFunction, points: Array, dual: DualVariables) -> LocalMaxima:
    """The points with the vertex of ddq where F is largest."""
    values_of_chunks = [function.values(points[chunk], dual) for chunk in _chunks(len(points))]
    values = np.vstack(values_of_chunks)
    best = values.argmax(axis=1)
    return LocalMaxima(points, function.viable.vertices[best], values[np.arange(len(values)), best])


def projected_gradient_ascent(
    function: DualFunction, peaks: LocalMaxima, dual: DualVariables, rule: StoppingRule
) -> LocalMaxima:
    """Projected gradient ascent from each, with the step lengths of Barzilai and Borwein (1988), monotone."""
    ascent = GradientAscent.begun(function, peaks, dual)
    points, value = ascent.points.copy(), ascent.value.copy()
    active, before = np.arange(len(value)), ascent.value
    for number in range(1, rule.steps + 1):
        ascent = ascent.moved(function, dual)
        if number % STEPS_PER_CHECK and number < rule.steps:
            continue
        points[active], value[active] = ascent.points, ascent.value
        continuing = rule.continues(ascent.value, ascent.value - before, float(value.max()), function.size)
        if not continuing.any():
            break
        ascent, active = ascent.chosen(continuing), active[continuing]
        before = ascent.value
    return at_best_vertex(function, points, dual)


@dataclass(frozen=True, eq=False)
class GradientAscent(AlignedArrays):
    """State of N ascents: points of the cube (N, 2n), ddq (N, n), F (N,), gradient (N, 2n) and step lengths (N,)."""

    points: Array
    ddq: Array
    value: Array
    slope: Array
    step: Array

    @classmethod
    def begun(cls, function: DualFunction, peaks: LocalMaxima, dual: DualVariables) -> GradientAscent:
        """At the points of the peaks, with constant ddq."""
        value, slope = function.value_and_gradient(peaks.points, peaks.ddq, dual)
        return cls(peaks.points, peaks.ddq, value, slope, FIRST_STEP / _largest(slope))

    def moved(self, function: DualFunction, dual: DualVariables) -> GradientAscent:
        """After one step."""
        tried = np.clip(self.points + self.step[:, None] * self.slope, -1, 1)
        value, slope = function.value_and_gradient(tried, self.ddq, dual)
        better = value > self.value
        longer = _curvature_step(tried - self.points, slope - self.slope)
        longer = np.clip(longer, self.step / 2, LONGEST_STEP / _largest(slope))
        return GradientAscent(
            np.where(better[:, None], tried, self.points),
            self.ddq,
            np.where(better, value, self.value),
            np.where(better[:, None], slope, self.slope),
            np.where(better, longer, STEP_REDUCTION * self.step),
        )


def local_maxima(
    function: DualFunction,
    dual: DualVariables,
    points: Array,
    *,
    keep: int,
    rule: StoppingRule,
    executor: Executor | None = None,
) -> LocalMaxima:
    """Ascents from the best point of each of `keep` groups, to which the points (N, 2n) are assigned in turn.

    The best of all would cluster about a few maxima, and others would be missed.
    """
    first = at_best_vertex(function, points, dual)
    groups = [np.arange(first_of, len(points), keep) for first_of in range(min(keep, len(points)))]
    chosen = first.chosen(np.array([group[first.value[group].argmax()] for group in groups]))
    chunks = [chosen.chosen(np.arange(len(chosen))[numbers]) for numbers in _chunks(len(chosen))]
    run = map if executor is None else executor.map
    count = len(chunks)
    maxima = run(projected_gradient_ascent, [function] * count, chunks, [dual] * count, [rule] * count)
    return reduce(LocalMaxima.joined, maxima)


@dataclass(frozen=True, eq=False)
class DualMaximum:
    """Local maxima of all ascents, the best of them refined, and the number of random starts."""

    peaks: LocalMaxima
    starts: int

    @property
    def value(self) -> float:
        """The largest F found."""
        return float(self.peaks.value.max())

    @property
    def ascents(self) -> int:
        """The number of ascents."""
        return len(self.peaks)


def maximise_dual_function(
    function: DualFunction,
    dual: DualVariables,
    support: Array,
    rng: np.random.Generator,
    *,
    count: int,
    executor: Executor | None = None,
) -> DualMaximum:
    """The largest F from `count` new random starts, and from points (N, 2n) of the cube where it may be large."""
    points = np.vstack([random_points(function.joints, count, rng), support])
    keep = count // STARTS_PER_ASCENT
    maxima = local_maxima(function, dual, points, keep=keep, rule=EVERY_ASCENT, executor=executor)
    order = np.argsort(-maxima.value)
    refined = projected_gradient_ascent(function, maxima.chosen(order[:REFINED_ASCENTS]), dual, REFINING_ASCENT)
    return DualMaximum(refined.joined(maxima.chosen(order[REFINED_ASCENTS:])), count)


def _chunks(count: int) -> list[slice]:
    return [slice(i, i + POINTS_PER_CALL) for i in range(0, count, POINTS_PER_CALL)]


def _largest(slope: Array) -> Array:
    return np.asarray(np.maximum(np.abs(slope).max(axis=1), 1e-9))


def _curvature_step(move: Array, change: Array) -> Array:
    """|s's / s'y| of each row."""
    curvature = np.abs((move * change).sum(axis=1))
    return np.asarray((move**2).sum(axis=1) / np.maximum(curvature, 1e-14))
