"""Descent: the constrained minimum, by cone programs that find the edge and Newton steps along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.cone_program import ConeProgram
from estimation.constrained.edge import Edge
from estimation.constrained.local_model import LeastSquares, LocalModel
from estimation.constrained.optimality import Optimality, sum_of_squares
from estimation.constrained.region import Region
from estimation.constrained.tangent import Tangent
from estimation.linear.descent import MOST_STEPS, STEP_TOLERANCE
from modeling.errors import TruewrenchError

Array = NDArray[np.float64]

MOST_NEWTON_STEPS = 20


def descend(problem: LeastSquares, region: Region, start: Array) -> Optimality:
    """The minimum of chi-square and prior over the region, from any start, with its multipliers.

    Sequential cone programs: each step minimises the local model over the whole region, so that every point after the
    first lies inside, and the sum of squares is its own merit; Levenberg's damping where the prediction is not
    straight. What a step rests on is then polished, and the answer is the first point that meets the conditions.
    Raises TruewrenchError when the solver finds no point at all.
    """
    local, merit, damping = LocalModel.at(problem, start, region.prior), np.inf, 0.0
    found = None
    for _ in range(MOST_STEPS):
        solution = ConeProgram(local, region, damping).solve()
        if solution is not None:
            edge = Edge.of_solution(region, local, solution).at(LocalModel.at(problem, solution.theta, region.prior))
            cost = edge.local.cost + region.added(solution.theta)
            if cost < merit:
                found = polished(problem, edge)
                if found.met or merit - cost < STEP_TOLERANCE:
                    break
                local, merit, damping = edge.local, cost, damping / 10 if damping > 1e-9 else 0.0
                continue
        damping = max(10 * damping, 1e-6)
        if damping > 1e6:
            break
    if found is None:
        raise TruewrenchError("constraints: the cone program has no solution within rounding; widen or remove some")
    return found


def polished(problem: LeastSquares, edge: Edge) -> Optimality:
    """Newton steps on the conditions of optimality with the edge held, as long as they halve what is left of them.

    A step that corrects the edge's curve can leave more before the next one leaves less: one such is forgiven.
    """
    best, region, failures = Optimality(edge), edge.region, 0
    latest = best
    for _ in range(MOST_NEWTON_STEPS):
        if failures > 1 or best.exact:
            break
        latest = Optimality(edge.at(LocalModel.at(problem, _along(latest), region.prior)))
        failures = 0 if latest.residual < best.residual / 2 else failures + 1
        best = latest if latest.residual < best.residual else best
    return best


def _along(found: Optimality) -> Array:
    """The point after one step along the edge, the ends held hit exactly; shorter where the prior forbids it."""
    edge, region = found.edge, found.edge.region
    step = Tangent(edge.local, *sum_of_squares(edge, found.inner), edge.normals, edge.values).step
    for _ in range(MOST_STEPS):
        theta = edge.local.theta + step
        theta = np.asarray(np.where(edge.low, region.low, np.where(edge.high, region.high, theta)))
        if np.isfinite(region.added(theta)):
            break
        step = step / 2
    return theta
