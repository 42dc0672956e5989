"""Whether a body can have a fit's inertial parameters: the pseudo-inertia's smallest eigenvalue, with its std."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constraints import SOLVER_TOLERANCE, cvxpy, solve_conic
from modeling.chain.model import WrenchModel
from modeling.chain.pseudo_inertia import PseudoInertia, pseudo_inertia
from modeling.identifiability import UnidentifiableDirection
from modeling.number_format import format_number
from modeling.significance import LEVELS

Array = NDArray[np.float64]


def impossible_body(
    model: WrenchModel,
    names: Sequence[str],
    theta: Array,
    covariance: Array,
    unidentifiable: Sequence[UnidentifiableDirection] = (),
    tool: str = "",
) -> str:
    """A sentence where no distribution of positive mass has the estimates, significantly or within their std.

    Empty where one has them, for some change along the `unidentifiable` directions, of which the data say nothing.
    `tool` is the name of an unknown load, of the tool with which it is.

    The pseudo-inertia of a body is positive definite (P. M. Wensing, S. Kim and J.-J. E. Slotine, IEEE Robotics and
    Automation Letters 3, 2018). It is affine in the parameters. Its smallest eigenvalue, at its largest along those
    directions, is concave in the parameters, so that with its std to first order it is not taken as too low.
    """
    inertia = pseudo_inertia(model.base)
    if tool:
        inertia = replace(inertia, names=tuple(f"{name}@{tool}" for name in inertia.names))
    place = [names.index(name) for name in inertia.names]
    inertia_covariance = covariance[np.ix_(place, place)]
    matrix, changes = inertia.at(theta[place]), _changes(inertia, unidentifiable)
    if np.linalg.eigvalsh(matrix)[0] >= 0 or (len(changes) and _has_completion(inertia, matrix, changes)):
        return ""
    smallest, weight = _largest_smallest_eigenvalue(matrix, changes)
    if smallest >= -SOLVER_TOLERANCE * np.abs(matrix).max():
        return ""
    gradient = np.einsum("ij,kij->k", weight, inertia.slopes)
    std = float(np.sqrt(gradient @ inertia_covariance @ gradient))
    whose = f"of the tool with {tool}: " if tool else ""
    estimate = f"{format_number(smallest, 2)} ± {format_number(std, 2)}"
    if smallest > -NormalDist().inv_cdf(1 - LEVELS.constraint) * std:
        return (
            f"{whose}the motion does not determine the inertia well enough for that of a body: the smallest eigenvalue"
            f" of the pseudo-inertia is {estimate}; --physical, Constraints(physical=True), keeps it positive"
        )
    return (
        f"{whose}no body has these inertial parameters: their pseudo-inertia has the eigenvalue {estimate}, which must"
        " be positive: something is missing in the model; --physical, Constraints(physical=True), keeps it positive"
    )


def _changes(inertia: PseudoInertia, directions: Sequence[UnidentifiableDirection]) -> Array:
    """Changes (d, n, n) of J along unidentifiable directions, without those that leave it as it is."""
    slopes = dict(zip(inertia.names, inertia.slopes, strict=True))
    changes = [
        sum(
            (a * slopes[name] for a, name in zip(direction.amounts, direction.names, strict=True) if name in slopes),
            start=np.zeros((inertia.size, inertia.size)),
        )
        for direction in directions
    ]
    return np.array([change for change in changes if change.any()]).reshape(-1, inertia.size, inertia.size)


def _has_completion(inertia: PseudoInertia, matrix: Array, changes: Array) -> bool:
    """Whether J is >= 0 after a large change, the nearest to one of all second moments alike; no cone program needed.

    It is for static poses, where nothing is known of the second moments and every positive mass will do.
    """
    others = [i for i in range(inertia.size) if i not in inertia.mass]
    mass, size = matrix[inertia.mass[0], inertia.mass[0]], float(np.linalg.norm(matrix))
    if mass <= 0:
        return False
    alike = np.zeros_like(matrix)
    alike[others, others] = 1.0
    columns = changes.reshape(len(changes), -1).T
    nearest = columns @ np.linalg.lstsq(columns, alike.ravel())[0]
    return bool(np.linalg.eigvalsh(matrix + size * (1 + size / mass) * nearest.reshape(matrix.shape))[0] >= 0)


def _largest_smallest_eigenvalue(matrix: Array, changes: Array) -> tuple[float, Array]:
    """The largest t <= 0 with J + sum_j s_j changes_j >= t 1 for some s, and its derivative (n, n) by J.

    Without changes it is the smallest eigenvalue, and its derivative v v'.
    """
    if not len(changes):
        values, vectors = np.linalg.eigh(matrix)
        return float(values[0]), np.outer(vectors[:, 0], vectors[:, 0])
    cp = cvxpy()
    size = len(matrix)
    sizes = np.linalg.norm(changes, axis=(1, 2))
    shift, least = cp.Variable(len(changes)), cp.Variable()
    moved = cp.reshape((changes / sizes[:, None, None]).reshape(len(changes), -1).T @ shift, (size, size), order="C")
    cone = matrix + moved - least * np.eye(size) >> 0
    if not solve_conic(cp.Problem(cp.Maximize(least), [cone, least <= 0])):
        return 0.0, np.zeros_like(matrix)  # nothing is said of what is not known
    return float(least.value), np.asarray(cone.dual_value)
