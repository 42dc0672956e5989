"""Cholesky factor of a diagonally scaled information matrix, whatever the units of its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CholeskyFactor:
    """M = D L L' D with D diagonal (scale, (k,)) such that L L' (lower, (k, k)) has a unit diagonal.

    A diagonal scaling that makes the diagonal constant is within a factor k of the best conditioned one (van der
    Sluis 1969), so that singularity does not depend on units.
    """

    scale: Array
    lower: Array

    @classmethod
    def of(cls, information: Array) -> Self | None:
        """The factor of M (k, k), None when M is singular.

        Singular is a pivot (squared) below k eps: that much of a unit diagonal is rounding.
        """
        size, diagonal = len(information), np.diag(information)
        if not np.isfinite(information).all() or not (diagonal > 0).all():
            return None
        scale = np.sqrt(diagonal)
        try:
            lower = np.asarray(np.linalg.cholesky(information / scale / scale[:, None]), dtype=float)
        except np.linalg.LinAlgError:
            return None
        regular = bool((np.diag(lower) ** 2 > size * np.finfo(float).eps).all())
        return cls(scale, lower) if regular else None

    @classmethod
    def required(cls, information: Array) -> Self:
        """The factor of M (k, k); InputError when M is singular."""
        found = cls.of(information)
        if found is None:
            raise InputError(
                what="it is singular: some combination of the parameters is unidentifiable",
                where="information",
                remedy="leave that combination out of the model, or start from an exciting trajectory",
            )
        return found

    @property
    def log_pivots(self) -> Array:
        """ln of the diagonal of L D, squared, (k,): they add up to ln det M."""
        return 2 * np.log(np.diag(self.lower) * self.scale)

    @cached_property
    def inverse(self) -> Array:
        """M^-1, (k, k)."""
        root = solve_triangular(self.lower, np.diag(1 / self.scale), lower=True)
        return np.asarray(root.T @ root)


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
