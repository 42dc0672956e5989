"""Proof: a rigorous upper bound of F over all viable states, by branch and bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import Dual, DualFunction
from design.bound.interval import IntervalFunction

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Share of k added to every enclosure: a million times what rounding of some thousand operations comes to."""
BATCH = 4000
"""Boxes that are split together: NumPy's overhead is small, and few are split that need not be."""


@dataclass(frozen=True)
class Proof:
    """F <= `upper` in every viable state, by that many boxes; `closed` when that is as near as was asked for."""

    upper: float
    closed: bool
    boxes: int
    seconds: float

    def __str__(self) -> str:
        state = "closed" if self.closed else "stopped at its budget"
        return f"F <= {self.upper:.4f} everywhere by branch and bound ({self.boxes} boxes, {state})"


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of the cube with a vertex of ddq each: low and high (N, 3n), and an upper bound of F in each (N,)."""

    low: Array
    high: Array
    upper: Array

    def chosen(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Boxes:
        """Those of an index or of a mask."""
        return Boxes(self.low[which], self.high[which], self.upper[which])

    def joined(self, other: Boxes) -> Boxes:
        """These and others."""
        return Boxes(*(np.concatenate([getattr(b, n) for b in (self, other)]) for n in ("low", "high", "upper")))


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Upper bounds of F with given multipliers over boxes of the cube of viable (q, dq), at vertices of ddq.

    With r the half widths, m the middle and G enclosing dF/du over the box (mean value form),
    F(u) <= F(m) + sum_i max|G_i| r_i, or the plain enclosure of F where that is less. Where G_i does not change its
    sign F is largest on that face, to which the box may shrink.
    """

    function: DualFunction
    dual: Dual

    @cached_property
    def _graph(self) -> Any:
        """CasADi function of (point, ddq) stacked: F, then its gradient by the point."""
        import casadi as ca

        n = self.function.joints
        both = ca.SX.sym("ua", 3 * n)
        value, slope = self.function.gradient(both[: 2 * n], self.dual.root, self.dual.c, both[2 * n :])
        return ca.Function("enclosed", [both], [ca.cse(ca.vertcat(value, slope))])

    @cached_property
    def _intervals(self) -> IntervalFunction:
        return IntervalFunction(self._graph)

    def boxes(self, low: Array, high: Array) -> tuple[Boxes, Array]:
        """The boxes from low to high (N, 3n), shrunk to faces that hold the maximum, and the slopes' size (N, 2n)."""
        n = self.function.joints
        below, above = self._intervals(low, high)
        low, high = low.copy(), high.copy()
        rising, falling = below[:, 1:] >= 0, above[:, 1:] <= 0
        points = slice(0, 2 * n)
        low[:, points] = np.where(rising, high[:, points], low[:, points])
        high[:, points] = np.where(falling & ~rising, low[:, points], high[:, points])
        steepest = np.maximum(-below[:, 1:], above[:, 1:])
        middle, half = (low + high) / 2, (high - low)[:, points] / 2
        there = np.array(self._graph.map(len(low))(middle.T))[0]
        upper = np.minimum(above[:, 0], there + (steepest * half).sum(axis=1))
        return Boxes(low, high, upper + ROUNDING * self.function.size), steepest


def proof(function: DualFunction, dual: Dual, *, target: float, seconds: float) -> Proof:
    """Branch and bound until no box may hold a larger F than `target`, or the time is up; always a valid bound.

    The boxes with the largest upper bounds are halved, along the side where the slope times the width is largest.
    """
    n, begun = function.joints, monotonic()
    enclosure = Enclosure(function, dual)
    vertices = function.viable.vertices
    ones = np.ones((len(vertices), 2 * n))
    open_, steepest = enclosure.boxes(np.hstack([-ones, vertices]), np.hstack([ones, vertices]))
    settled, count = -np.inf, len(vertices)
    while len(open_.upper) and monotonic() - begun < seconds:
        order = np.argsort(-open_.upper)
        first, rest = order[:BATCH], order[BATCH:]
        low, high = _halved(open_.chosen(first), steepest[first])
        new, slopes = enclosure.boxes(low, high)
        together = open_.chosen(rest).joined(new)
        steepest = np.vstack([steepest[rest], slopes])
        todo = together.upper > target
        settled = max(settled, float(together.upper[~todo].max(initial=-np.inf)))
        open_, steepest, count = together.chosen(todo), steepest[todo], count + len(low)
    upper = max(settled, float(open_.upper.max(initial=-np.inf)))
    return Proof(upper, not len(open_.upper), count, monotonic() - begun)


def _halved(boxes: Boxes, steepest: Array) -> tuple[Array, Array]:
    """Both halves of each box, low and high (2N, 3n)."""
    width = (boxes.high - boxes.low)[:, : steepest.shape[1]]
    side = (steepest * width).argmax(axis=1)
    rows = np.arange(len(side))
    middle = (boxes.low[rows, side] + boxes.high[rows, side]) / 2
    left, right = boxes.high.copy(), boxes.low.copy()
    left[rows, side], right[rows, side] = middle, middle
    return np.vstack([boxes.low, right]), np.vstack([left, boxes.high])
