"""Cholesky factor of an information matrix as CasADi expressions, and whether a matrix has one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_regular(information: NDArray[np.float64]) -> bool:
    """Whether M (k, k) is positive definite beyond rounding, whatever the units of its parameters.

    M is scaled to a unit diagonal, within a factor k of the best conditioned diagonal scaling (van der Sluis 1969).
    Singular is a pivot of its Cholesky factor (squared) below k eps: that much of a unit diagonal is rounding.
    """
    diagonal = np.diag(information)
    if not np.isfinite(information).all() or not (diagonal > 0).all():
        return False
    try:
        lower = np.linalg.cholesky(information / np.sqrt(diagonal) / np.sqrt(diagonal)[:, None])
    except np.linalg.LinAlgError:
        return False
    return bool((np.diag(lower) ** 2 > len(information) * np.finfo(float).eps).all())


def symbolic_pivots(information: Any) -> tuple[Any, Any]:
    """Unit lower L and pivots d (k) of M = L diag(d) L', as CasADi SX: Cholesky's without its roots.

    d_j = M_jj - sum_i<j L_ji² d_i and L_ij = (M_ij - sum_l<j L_il L_jl d_l) / d_j, unrolled.
    """
    import casadi as ca

    size = information.shape[0]
    lower, pivots = ca.SX.eye(size), ca.SX.zeros(size, 1)
    for j in range(size):
        scaled = lower[j, :j].T * pivots[:j, 0]
        pivots[j] = information[j, j] - ca.dot(lower[j, :j].T, scaled)
        for i in range(j + 1, size):
            lower[i, j] = (information[i, j] - ca.dot(lower[i, :j].T, scaled)) / pivots[j]
    return lower, pivots


def symbolic_inverse(information: Any) -> Any:
    """M^-1 = L^-T diag(1/d) L^-1 as CasADi SX."""
    import casadi as ca

    lower, pivots = symbolic_pivots(information)
    root = _unit_inverse(lower)
    return root.T @ ca.diag(1 / pivots) @ root


def _unit_inverse(lower: Any) -> Any:
    """Inverse of a unit lower triangle by forward substitution, row by row."""
    import casadi as ca

    size = lower.shape[0]
    inverse = ca.SX.eye(size)
    for i in range(1, size):
        inverse[i, :i] = -lower[i, :i] @ inverse[:i, :i]
    return inverse
