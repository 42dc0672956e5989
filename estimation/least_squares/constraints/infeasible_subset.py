"""Irreducible infeasible subset of constraints, by deletion filter."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constraints.conic_solver import cvxpy, solve_conic
from estimation.least_squares.constraints.feasible_region import BoundSide, FeasibleRegion
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.errors import InputError

Array = NDArray[np.float64]

MIN_EIGENVALUE = 1e-7
"""Smallest eigenvalue, of a matrix of unit size, that counts as positive: ten times the solver's tolerance."""


def require_interior(region: FeasibleRegion) -> None:
    """Raise InputError, naming an irreducible infeasible subset, unless the region has an interior."""
    crossed = _crossed_bounds(region.sides)
    if crossed:
        raise _infeasibility_error(list(crossed), None, region.where)
    inertia = region.cone if region.prior is None else region.prior.inertia
    if inertia is None:
        return
    sides = [s for s in region.sides if inertia.slopes[s.index].any()]
    if sides and not has_interior(inertia, sides):
        raise _infeasibility_error(irreducible_infeasible_subset(inertia, sides), inertia, region.where)


def _crossed_bounds(sides: Sequence[BoundSide]) -> tuple[BoundSide, BoundSide] | None:
    """A lower bound above an upper bound of the same parameter."""
    for first, second in product(sides, sides):
        same = first.index == second.index and first.lower and not second.lower
        if same and first.value > second.value:
            return first, second
    return None


def irreducible_infeasible_subset(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> list[BoundSide]:
    """Bounds infeasible with J > 0, none of them redundant, by a deletion filter.

    Each bound is left out in turn, permanently if the others are still infeasible: the remaining set is irreducible.
    Chinneck and Dravnieks, "Locating minimal infeasible constraint sets in linear programs" (ORSA Journal on Computing
    3, 1991).
    """
    subset = list(sides)
    for side in sides:
        others = [s for s in subset if s is not side]
        if not has_interior(inertia, others):
            subset = others
    return subset


def has_interior(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> bool:
    """Whether J(theta) can be positive definite within the given bounds.

    Maximises t <= 1 with T J T >= t 1; T, diagonal, scales J to unit size and does not change its definiteness.
    """
    cp = cvxpy()
    involved = [i for i, slope in enumerate(inertia.slopes) if slope.any()]
    scale = _bounded_inertia_scale(inertia, sides)
    flat = (inertia.slopes[involved] / np.outer(scale, scale)).reshape(len(involved), -1).T
    theta, margin = cp.Variable(len(involved)), cp.Variable()
    moved = cp.reshape(flat @ theta, (inertia.size, inertia.size), order="C")
    matrix = inertia.constant / np.outer(scale, scale) + moved
    conditions = [matrix >> margin * np.eye(inertia.size), margin <= 1]
    for side in sides:
        value = theta[involved.index(side.index)]
        conditions.append(value >= side.value if side.lower else value <= side.value)
    return solve_conic(cp.Problem(cp.Maximize(margin), conditions)) and float(margin.value) > MIN_EIGENVALUE


def _bounded_inertia_scale(inertia: PseudoInertia, sides: Sequence[BoundSide]) -> Array:
    """Square roots (n,) of the size that the bounds give J's diagonal; 1 where they do not limit it."""
    size = np.zeros(len(inertia.slopes))
    for side in sides:
        size[side.index] = max(size[side.index], abs(side.value))
    diagonal = size @ np.abs(np.diagonal(inertia.slopes, axis1=1, axis2=2)) + np.abs(np.diag(inertia.constant))
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def _infeasibility_error(sides: Sequence[BoundSide], inertia: PseudoInertia | None, where: str) -> InputError:
    *first, last = [side.text for side in sides]
    named = f"{', '.join(first)} and {last} are infeasible together" if first else f"{last} is infeasible"
    against = "" if inertia is None else f" with physical consistency, {inertia.condition}"
    return InputError(what=f"{named}{against}", where=where, remedy="widen or remove one of them")
