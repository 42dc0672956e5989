"""Rigorous bound of F over all viable states by branch and bound."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log
from time import monotonic

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables
from design.bound.multistart_ascent import AlignedArrays
from design.trajectories.trajectory import Trajectory
from modeling.compiled.tape import NO_OPERAND, Tape
from modeling.errors import InputError
from modeling.table import Table, Tabular

Array = NDArray[np.float64]
IntervalArrays = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class IntervalEvaluation:
    """A tape without parameters, evaluated with intervals, operation by operation (R. E. Moore, 1966).

    Every operation gives an interval that contains all its values over the arguments' intervals, so that the result
    encloses the range of the function over a box. Ends are rounded to nearest: valid up to rounding.

    Raises InputError for an operation that has no enclosure here.
    """

    tape: Tape

    def __call__(self, low: Array, high: Array) -> IntervalArrays:
        """Enclosures low and high (N, results) over boxes from low to high, (N, inputs)."""
        tape = self.tape
        last = {operand: at for at, (_, *operands) in enumerate(tape.operations) for operand in operands}
        values: dict[int, IntervalArrays] = dict(enumerate(zip(low.T, high.T, strict=True)))
        for i, constant in enumerate(tape.constants):
            everywhere = np.full(len(low), constant)
            values[tape.inputs + i] = everywhere, everywhere
        for at, (name, *numbers) in enumerate(tape.operations):
            if name not in INTERVAL_OPERATIONS:
                what = f"the operation '{name}' has no enclosure, so that no bound can be proven for this model"
                raise InputError(what=what, where="proof", remedy="take the bound without a proof")
            operands = [number for number in numbers if number != NO_OPERAND]
            values[tape.first + at] = INTERVAL_OPERATIONS[name](*(values[number] for number in operands))
            for number in {*operands} - {*tape.results}:
                if last[number] == at:
                    del values[number]  # not read again
        ends = [values[number] for number in tape.results]
        return np.stack([below for below, _ in ends], axis=1), np.stack([above for _, above in ends], axis=1)


def _product(a: IntervalArrays, b: IntervalArrays) -> IntervalArrays:
    corners = (a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])
    low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
    high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
    return low, high


def _quotient(a: IntervalArrays, b: IntervalArrays) -> IntervalArrays:
    """The whole real line where the divisor's interval contains zero."""
    crosses = (b[0] <= 0) & (b[1] >= 0)
    low, high = np.where(crosses, 1.0, b[1]), np.where(crosses, 1.0, b[0])
    below, above = _product(a, (1 / low, 1 / high))
    return np.where(crosses, -np.inf, below), np.where(crosses, np.inf, above)


def _square(a: IntervalArrays) -> IntervalArrays:
    first, second = a[0] ** 2, a[1] ** 2
    spans = (a[0] <= 0) & (a[1] >= 0)
    return np.where(spans, 0.0, np.minimum(first, second)), np.maximum(first, second)


def _sine(a: IntervalArrays) -> IntervalArrays:
    """-1 or 1 where the interval contains a minimum or maximum of sin, else the values at the ends."""
    first, second = np.sin(a[0]), np.sin(a[1])
    top = np.ceil((a[0] - np.pi / 2) / (2 * np.pi)) * 2 * np.pi + np.pi / 2 <= a[1]
    bottom = np.ceil((a[0] + np.pi / 2) / (2 * np.pi)) * 2 * np.pi - np.pi / 2 <= a[1]
    low, high = np.minimum(first, second), np.maximum(first, second)
    return np.where(bottom, -1.0, low), np.where(top, 1.0, high)


INTERVAL_OPERATIONS: Mapping[str, Callable[..., IntervalArrays]] = {
    "add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: (a[0] - b[1], a[1] - b[0]),
    "neg": lambda a: (-a[1], -a[0]),
    "twice": lambda a: (2 * a[0], 2 * a[1]),
    "mul": _product,
    "div": _quotient,
    "inv": lambda a: _quotient((np.ones_like(a[0]), np.ones_like(a[1])), a),
    "sq": _square,
    "sin": _sine,
    "cos": lambda a: _sine((a[0] + np.pi / 2, a[1] + np.pi / 2)),
}
"""The enclosure of each operation, by its name on a tape."""


# Weak duality checked along one trajectory, and its quadrature error.


GAUSS_POINTS = 8
"""Points of the Gauss-Legendre rule in each piece: exact to degree 15."""
PIECES_PER_STRETCH = 16
"""Pieces between two breaks of a series: F has some ten times the frequencies of the trajectory."""
FEWEST_PIECES = 400
"""Pieces of a whole period at least, for series that have no breaks: 20 per wave of a 20th harmonic."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WeakDuality(Tabular):
    """Weak duality along one trajectory; all ln det are of N samples.

    excess      largest violation of viability by its states, in shares of the limits; negative inside
    dual        mean of F over a period: at most k when the trajectory is within the limits
    conditions  largest |mean of L h| over the rms of L h: zero but for quadrature and rounding
    logdet      of N times the mean over time, to which the bound applies
    sampled     of the N equally spaced samples
    weak        -ln det D + k ln(mean F / k) + k ln N: between logdet and the bound
    """

    excess: float
    dual: float
    conditions: float
    logdet: float
    sampled: float
    weak: float

    @property
    def quadrature(self) -> float:
        """sampled - logdet: the quadrature error of the samples in ln det of the mean over time."""
        return self.sampled - self.logdet

    @property
    def table(self) -> Table:
        """Each quantity that weak duality relates."""
        rows = [
            ("violation of viability", f"{self.excess:.1e} of the limits"),
            ("mean of F over the period", f"{self.dual:.4f}"),
            ("largest mean of a periodicity condition", f"{self.conditions:.1e} of its rms"),
            ("ln det, mean over time", f"{self.logdet:.4f}"),
            ("ln det, samples", f"{self.sampled:.4f}: quadrature error {self.quadrature:+.1e}"),
            ("weak duality: bound from its mean of F", f"{self.weak:.4f}"),
        ]
        return Table.of(("", ""), rows)

    @classmethod
    def of(cls, function: DualFunction, dual: DualVariables, motion: Trajectory, samples: int) -> WeakDuality:
        """By quadrature between the breaks of the series."""
        time, weights = _quadrature(motion)
        q, dq, ddq = motion.evaluate(time)
        gram, rates = function.moments(np.hstack([q, dq, ddq]))
        mean, rate = np.tensordot(weights, gram, axes=1), weights @ rates
        value, k = float(np.sum(dual.D * mean) + rate @ dual.c), function.size
        rms = np.sqrt(weights @ rates**2)
        share = np.abs(rate) / np.where(rms > 0, rms, 1.0)
        sampled = function.experiment.information(motion, samples)
        return cls(
            excess=float(function.viable.excess(q, dq, ddq).max()),
            dual=value,
            conditions=float(share.max(initial=0.0)),
            logdet=float(np.linalg.slogdet(mean)[1]) + k * log(samples),
            sampled=float(np.linalg.slogdet(sampled)[1]),
            weak=dual.value + k * log(max(value, np.finfo(float).tiny) / k) + k * log(samples),
        )


def _quadrature(motion: Trajectory) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in (0, T) and weights that sum to one."""
    breaks = motion.series.breaks
    pieces = max(PIECES_PER_STRETCH, -(-FEWEST_PIECES // (len(breaks) - 1)))
    fine = np.interp(np.arange(pieces * (len(breaks) - 1) + 1) / pieces, np.arange(len(breaks)), breaks)
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    middle, half = (fine[1:] + fine[:-1]) / 2, np.diff(fine) / 2
    time = (middle[:, None] + half[:, None] * nodes).ravel()
    return time, (half[:, None] * weights).ravel() / (breaks[-1] - breaks[0])


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
