"""Constrained minimum by sequential cone programs, polished by Newton steps on the active set."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.active_set import ActiveSet
from estimation.least_squares.constrained.cone_program import ConeProgram
from estimation.least_squares.constrained.kkt_conditions import KKTConditions, sum_of_squares
from estimation.least_squares.constrained.null_space_step import NullSpaceStep
from estimation.least_squares.constrained.quadratic_model import LeastSquaresProblem, QuadraticModel
from estimation.least_squares.constraints.feasible_region import FeasibleRegion
from estimation.least_squares.levenberg_marquardt import MAX_STEPS
from modeling.errors import TruewrenchError

Array = NDArray[np.float64]

MAX_NEWTON_STEPS = 20
LEAST_DECREASE = 1e-6
"""Of chi-square: where steps gain less, the point is as near to the conditions as they bring it."""


def sequential_cone_programs(problem: LeastSquaresProblem, region: FeasibleRegion, start: Array) -> KKTConditions:
    """The minimum of chi-square and prior over the region, from any initial value, with its multipliers.

    Each step minimises the quadratic model over the whole region, so that every iterate after the first is feasible and
    the sum of squares is the merit function; Levenberg damping handles nonlinear predictions. The active set of a step
    is then polished, and the result is the first point that meets the KKT conditions.
    Raises TruewrenchError when the solver finds no point at all.
    """
    local, merit, damping = QuadraticModel.at(problem, start, region.prior), np.inf, 0.0
    found = None
    for _ in range(MAX_STEPS):
        solution = ConeProgram(local, region, damping).solve()
        if solution is not None:
            active_set = ActiveSet.of_solution(region, local, solution).at(
                QuadraticModel.at(problem, solution.theta, region.prior)
            )
            cost = active_set.local.cost + region.added(solution.theta)
            if cost < merit:
                found = newton_polished(problem, active_set)
                if found.met or merit - cost < LEAST_DECREASE:
                    break
                local, merit, damping = active_set.local, cost, damping / 10 if damping > 1e-9 else 0.0
                continue
        damping = max(10 * damping, 1e-6)
        if damping > 1e6:
            break
    if found is None:
        raise TruewrenchError(
            "constraints: the solver found no solution of the cone program; widen or remove some of them"
        )
    return found


def newton_polished(problem: LeastSquaresProblem, active_set: ActiveSet) -> KKTConditions:
    """Newton steps on the KKT conditions with the active set held, as long as they halve the residual.

    A step that corrects the curvature of the boundary can increase the residual before the next one reduces it: one
    such step is allowed.
    """
    best, region, failures = KKTConditions(active_set), active_set.region, 0
    latest = best
    for _ in range(MAX_NEWTON_STEPS):
        if failures > 1 or best.exact:
            break
        latest = KKTConditions(active_set.at(QuadraticModel.at(problem, _tangent_step(latest), region.prior)))
        failures = 0 if latest.residual < best.residual / 2 else failures + 1
        best = latest if latest.residual < best.residual else best
    return best


def _tangent_step(found: KKTConditions) -> Array:
    """The point after one step on the active set, active bounds met exactly; halved until the prior is finite."""
    active_set, region = found.active_set, found.active_set.region
    step = NullSpaceStep(
        active_set.local, *sum_of_squares(active_set, found.inner), active_set.normals, active_set.values
    ).step
    theta = _with_active_bounds(active_set, step)
    for _ in range(MAX_STEPS - 1):
        if np.isfinite(region.added(theta)):
            break
        step = step / 2
        theta = _with_active_bounds(active_set, step)
    return theta


def _with_active_bounds(active_set: ActiveSet, step: Array) -> Array:
    """The point a step away from the active set's, its active bounds met exactly."""
    region, theta = active_set.region, active_set.local.theta + step
    return np.asarray(np.where(active_set.low, region.low, np.where(active_set.high, region.high, theta)))
