"""Contradiction: the smallest set of constraints that no parameters can keep together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.region import Region, Side
from estimation.constrained.solver import cvxpy, solved
from modeling.errors import InputError
from modeling.pseudo_inertia import PseudoInertia

Array = NDArray[np.float64]

LEAST_MARGIN = 1e-7
"""Smallest eigenvalue, of a matrix of unit size, that counts as positive: ten times what the solver leaves open."""


def require_interior(region: Region) -> None:
    """Raise InputError, naming the smallest contradictory set, unless something lies strictly inside the region."""
    crossed = _crossed(region.sides)
    if crossed:
        raise _refusal(list(crossed), None, region.where)
    inertia = region.inertia if region.prior is None else region.prior.inertia
    if inertia is None:
        return
    sides = [s for s in region.sides if inertia.slopes[s.index].any()]
    if sides and not has_interior(inertia, sides):
        raise _refusal(minimal(inertia, sides), inertia, region.where)


def _crossed(sides: Sequence[Side]) -> tuple[Side, Side] | None:
    """Two ends of one unknown that leave nothing between them."""
    for first, second in product(sides, sides):
        same = first.index == second.index and first.lower and not second.lower
        if same and first.value > second.value:
            return first, second
    return None


def minimal(inertia: PseudoInertia, sides: Sequence[Side]) -> list[Side]:
    """The ends that contradict J > 0, none of which could be spared, by a deletion filter.

    Each end is left out in turn, for good when the rest still contradict: what stays is irreducible. Chinneck and
    Dravnieks, "Locating minimal infeasible constraint sets in linear programs" (ORSA Journal on Computing 3, 1991).
    """
    kept = list(sides)
    for side in sides:
        rest = [s for s in kept if s is not side]
        if not has_interior(inertia, rest):
            kept = rest
    return kept


def has_interior(inertia: PseudoInertia, sides: Sequence[Side]) -> bool:
    """Whether J(theta) can be positive definite between the given ends.

    The largest t <= 1 with T J T >= t 1 is sought; T, diagonal, brings J to unit size and does not change its sign.
    """
    cp = cvxpy()
    involved = [i for i, slope in enumerate(inertia.slopes) if slope.any()]
    scale = _size(inertia, sides)
    flat = (inertia.slopes[involved] / np.outer(scale, scale)).reshape(len(involved), -1).T
    theta, margin = cp.Variable(len(involved)), cp.Variable()
    moved = cp.reshape(flat @ theta, (inertia.size, inertia.size), order="C")
    matrix = inertia.constant / np.outer(scale, scale) + moved
    conditions = [matrix >> margin * np.eye(inertia.size), margin <= 1]
    for side in sides:
        value = theta[involved.index(side.index)]
        conditions.append(value >= side.value if side.lower else value <= side.value)
    return solved(cp.Problem(cp.Maximize(margin), conditions)) and float(margin.value) > LEAST_MARGIN


def _size(inertia: PseudoInertia, sides: Sequence[Side]) -> Array:
    """Square roots (n,) of the size that the ends give J's diagonal; 1 where they leave it open."""
    reach = np.zeros(len(inertia.slopes))
    for side in sides:
        reach[side.index] = max(reach[side.index], abs(side.value))
    diagonal = reach @ np.abs(np.diagonal(inertia.slopes, axis1=1, axis2=2)) + np.abs(np.diag(inertia.constant))
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def _refusal(sides: Sequence[Side], inertia: PseudoInertia | None, where: str) -> InputError:
    *first, last = [side.text for side in sides]
    named = f"{', '.join(first)} and {last} contradict" if first else f"{last} contradicts"
    against = "each other" if inertia is None else f"physical consistency, {inertia.condition}"
    return InputError(what=f"{named} {against}", where=where, remedy="widen or remove one of them")
