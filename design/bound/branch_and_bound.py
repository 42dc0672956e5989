"""Rigorous bound of F over all viable states by branch and bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables
from design.bound.interval_arithmetic import IntervalEvaluation
from design.bound.multistart_ascent import AlignedArrays
from modeling.evaluation.tape import Tape

Array = NDArray[np.float64]

ENCLOSURE_ROUNDING = 1e-9
"""Share of k added to every enclosure: a million times the rounding error of some thousand operations."""
BOXES_PER_ROUND = 4000
"""Boxes split together: NumPy's overhead is small, and few are split needlessly."""


@dataclass(frozen=True)
class BranchAndBoundResult:
    """F <= `upper` in every viable state, from a number of boxes; `closed` when the target was reached."""

    upper: float
    closed: bool
    boxes: int
    seconds: float

    def __str__(self) -> str:
        state = "closed" if self.closed else "stopped at its budget"
        return f"F <= {self.upper:.4f} everywhere by branch and bound ({self.boxes} boxes, {state})"


@dataclass(frozen=True, eq=False)
class StateBoxes(AlignedArrays):
    """Boxes of the cube with a vertex of ddq each: low and high (N, 3n), and an upper bound of F in each (N,)."""

    low: Array
    high: Array
    upper: Array


@dataclass(frozen=True, eq=False)
class DualFunctionEnclosure:
    """Upper bounds of F with given multipliers over boxes of the cube of viable (q, dq), at vertices of ddq.

    With r the half widths, m the middle and G enclosing dF/du over the box (mean value form),
    F(u) <= F(m) + sum_i max|G_i| r_i, or the natural interval extension of F where that is less. Where G_i does not
    change its sign F is largest on one face, to which the box is reduced (monotonicity test).
    """

    function: DualFunction
    dual: DualVariables

    @cached_property
    def _intervals(self) -> IntervalEvaluation:
        """F, then its gradient by the point, of (point, ddq)."""
        import casadi as ca

        n = self.function.joints
        both = ca.SX.sym("ua", 3 * n)
        value, slope = self.function.gradient(both[: 2 * n], both[2 * n :], self.dual.root, self.dual.c)
        return IntervalEvaluation(Tape.of(both, ca.SX(0, 1), ca.vertcat(value, slope)))

    def boxes(self, low: Array, high: Array) -> tuple[StateBoxes, Array]:
        """The boxes from low to high (N, 3n), reduced by the monotonicity test, and the largest |G_i| (N, 2n)."""
        n = self.function.joints
        below, above = self._intervals(low, high)
        low, high = low.copy(), high.copy()
        rising, falling = below[:, 1:] >= 0, above[:, 1:] <= 0
        points = slice(0, 2 * n)
        low[:, points] = np.where(rising, high[:, points], low[:, points])
        high[:, points] = np.where(falling & ~rising, low[:, points], high[:, points])
        steepest = np.maximum(-below[:, 1:], above[:, 1:])
        middle, half = (low + high) / 2, (high - low)[:, points] / 2
        centre, _ = self.function.value_and_gradient(middle[:, points], middle[:, 2 * n :], self.dual)
        upper = np.minimum(above[:, 0], centre + (steepest * half).sum(axis=1))
        return StateBoxes(low, high, upper + ENCLOSURE_ROUNDING * self.function.size), steepest


def branch_and_bound(
    function: DualFunction, dual: DualVariables, *, target: float, seconds: float
) -> BranchAndBoundResult:
    """Branch and bound until no box can contain F above `target`, or the time is up; always a valid bound.

    The boxes with the largest upper bounds are halved, along the side where the slope times the width is largest.
    """
    n, begun = function.joints, monotonic()
    enclosure = DualFunctionEnclosure(function, dual)
    vertices = function.viable.vertices
    ones = np.ones((len(vertices), 2 * n))
    open_, steepest = enclosure.boxes(np.hstack([-ones, vertices]), np.hstack([ones, vertices]))
    fathomed, count = -np.inf, len(vertices)
    while len(open_.upper) and monotonic() - begun < seconds:
        order = np.argsort(-open_.upper)
        first, rest = order[:BOXES_PER_ROUND], order[BOXES_PER_ROUND:]
        low, high = _halved(open_.chosen(first), steepest[first])
        new, slopes = enclosure.boxes(low, high)
        boxes = open_.chosen(rest).joined(new)
        steepest = np.vstack([steepest[rest], slopes])
        above = boxes.upper > target
        fathomed = max(fathomed, float(boxes.upper[~above].max(initial=-np.inf)))
        open_, steepest, count = boxes.chosen(above), steepest[above], count + len(low)
    upper = max(fathomed, float(open_.upper.max(initial=-np.inf)))
    return BranchAndBoundResult(upper, not len(open_.upper), count, monotonic() - begun)


def _halved(boxes: StateBoxes, steepest: Array) -> tuple[Array, Array]:
    """Both halves of each box, low and high (2N, 3n)."""
    width = (boxes.high - boxes.low)[:, : steepest.shape[1]]
    side = (steepest * width).argmax(axis=1)
    rows = np.arange(len(side))
    middle = (boxes.low[rows, side] + boxes.high[rows, side]) / 2
    left, right = boxes.high.copy(), boxes.low.copy()
    left[rows, side], right[rows, side] = middle, middle
    return np.vstack([boxes.low, right]), np.vstack([left, boxes.high])
