"""Interior point: the largest value of an exact criterion within limits that are linear in the coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from design.optimiser.expansion import Expansion
from design.optimiser.polytope import Polytope
from design.optimiser.program import Outcome, Solution

Array = NDArray[np.float64]

FASTER, POWER = 0.2, 1.5
"""The barrier parameter goes from mu to the smaller of 0.2 mu and mu^1.5 (Waechter and Biegler 2006, eq. 7)."""
SOLVED = 10.0
"""A barrier problem is solved when its error is below so many mu (the same, eq. 6)."""
TO_THE_WALL = 0.99
"""Share of the way to the nearest limit that a step may go (the same, eq. 8)."""
ENOUGH = 1e-4
"""Armijo's share of the predicted decrease: any small one will do."""
SHORTEST = 1e-10
"""A step as short as this no longer changes the point."""
ROUNDING = 1e-12
"""Of a barrier problem's value, which is a sum of thousands of logarithms: less than this is no change."""
SPREAD = 1e10
"""By which a multiplier may differ from mu over its slack, either way (the same, eq. 16)."""
FLAT = 1e-8
"""Of the largest curvature: along directions with less the step is no longer than with this."""


@dataclass(frozen=True, eq=False)
class Point:
    """Coefficients (k,), the criterion there, what the limits leave (2, R) and their multipliers (2, R)."""

    z: Array
    value: float
    slack: Array
    dual: Array

    def barrier(self, mu: float) -> float:
        """What the barrier problem minimises."""
        return -self.value - mu * float(np.log(self.slack).sum())


@dataclass(frozen=True, eq=False)
class Interior:
    """maximise f(z) within a polytope, from a z inside it, by a primal-dual interior point that stays inside.

    For slacks s = 1 -+ (A z - middle) and multipliers y the conditions of the barrier problem are
    -f'(z) + A'(y_high - y_low) = 0 and s y = mu. Newton's step, with y eliminated, solves

        (-f''(z) + A' diag(y / s) A) dz = f'(z) - A'(mu / s_high - mu / s_low),

    k equations whatever the number of rows. Where the matrix is not positive definite its eigenvalues are replaced by
    their absolute values, so that the step goes down (Gill, Murray and Wright 1981, section 4.4.2.1). Steps are halved
    until the barrier problem's value decreases enough; mu follows Waechter and Biegler (2006).
    """

    expansion: Expansion
    polytope: Polytope

    def solve(self, start: Array, *, first: float, last: float, iterations: int) -> Solution:
        """From z (k,) inside; the barrier parameters mu, in nats, go from the first to the last.

        The rows that press (some dozens) leave about mu each to be gained.
        """
        slack, mu, evaluations = self.polytope.slack(start), first, 1
        point = Point(start, self.expansion.value(start), slack, mu / slack)
        for _ in range(iterations):
            gradient, hessian = self.expansion.second_order(point.z)
            balance = self.polytope.pushed(point.dual) - gradient
            mu = _next(mu, last, point, balance)
            if mu <= last and _error(point, balance, mu) <= SOLVED * mu:
                return Solution(point.z, Outcome.CONVERGED, evaluations)
            slope = self.polytope.pushed(mu / point.slack) - gradient
            step = descent(self.polytope.gram(point.dual / point.slack) - hessian, slope)
            moved, asked = self._moved(point, step, float(slope @ step), mu)
            evaluations += asked
            if moved is None:
                return Solution(point.z, Outcome.FAILED, evaluations)
            point = moved
        return Solution(point.z, Outcome.ITERATIONS, evaluations)

    def _moved(self, point: Point, step: Array, slope: float, mu: float) -> tuple[Point | None, int]:
        """The point after the longest of t, t/2, t/4 .. of the step that goes down enough, and how many were tried."""
        change = self.polytope.change(step)
        change = np.stack([-change, change])
        towards = mu / point.slack - point.dual * (1 + change / point.slack)
        before, length, asked = point.barrier(mu), _longest(point.slack, change), 0
        while length > SHORTEST:
            z, slack, asked = point.z + length * step, point.slack + length * change, asked + 1
            dual = point.dual + _longest(point.dual, towards) * towards
            dual = np.clip(dual, mu / (SPREAD * slack), SPREAD * mu / slack)
            moved = Point(z, self.expansion.value(z), slack, dual)
            if moved.barrier(mu) <= before + ENOUGH * length * slope + ROUNDING * abs(before):
                return moved, asked
            length /= 2
        return None, asked


def descent(matrix: Array, slope: Array) -> Array:
    """-matrix^-1 slope (k,), or with the matrix's eigenvalues made positive, in the scale of its diagonal."""
    try:
        return np.asarray(-cho_solve(cho_factor(matrix, check_finite=False), slope, check_finite=False))
    except LinAlgError:
        scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
        values, axes = np.linalg.eigh(matrix * scale * scale[:, None])
        size = np.abs(values)
        return np.asarray(-scale * (axes @ ((axes.T @ (scale * slope)) / np.maximum(size, FLAT * size.max()))))


def _next(mu: float, last: float, point: Point, balance: Array) -> float:
    """The barrier parameter, smaller as long as its problem is solved."""
    while mu > last and _error(point, balance, mu) <= SOLVED * mu:
        mu = max(last, min(FASTER * mu, mu**POWER))
    return mu


def _error(point: Point, balance: Array, mu: float) -> float:
    return max(float(np.abs(balance).max()), float(np.abs(point.slack * point.dual - mu).max()))


def _longest(values: Array, change: Array) -> float:
    """The largest part of a step, up to the whole, that leaves positive values positive."""
    return min(1.0, TO_THE_WALL / max(float((-change / values).max()), np.finfo(float).tiny))
