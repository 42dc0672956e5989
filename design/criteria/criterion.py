"""Optimality criterion: a concave function of the information, as a CasADi expression, with value and gradient."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError


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
    lower, pivots = symbolic_pivots(information)
    root = _unit_inverse(lower)
    return root.T @ ca.diag(1 / pivots) @ root


def _unit_inverse(lower: Any) -> Any:
    """Inverse of a unit lower triangle by forward substitution, row by row."""
    size = lower.shape[0]
    inverse = ca.SX.eye(size)
    for i in range(1, size):
        inverse[i, :i] = -lower[i, :i] @ inverse[:i, :i]
    return inverse


Array = NDArray[np.float64]


class Criterion(ABC):
    """A concave and monotone function of the information M (k, k), symmetric and positive definite.

    Every member is the logarithm of a positively homogeneous mean of M (Pukelsheim, Optimal Design of Experiments,
    chapter 5), times its `degree`: value(c M) = value(M) + degree ln c. So a difference of values does not depend on
    units: exp(difference / degree) is the factor in the number of measurements that makes up for it.
    A member is its `expression`; value, gradient and graph are compiled from it, once for each member: it can be
    hashed, as a frozen dataclass is, one with arrays by `eq=False`.
    """

    name: ClassVar[str]
    """Its name in tables."""
    unit: ClassVar[str] = "nat"

    @abstractmethod
    def expression(self, information: Any) -> Any:
        """The value as a CasADi SX expression of M, an SX matrix that is symmetric entry by entry."""

    @abstractmethod
    def degree(self, size: int) -> float:
        """The growth of the value of a (size, size) information when M is multiplied by e."""

    def blocks(self, information: Any) -> list[Any]:
        """The diagonal blocks of M that the value depends on: minus infinity where one of them is singular."""
        return [information]

    def value(self, information: Array) -> float:
        """The criterion at M (k, k); minus infinity when M is singular."""
        return float(_function(self, len(information))(information)) if self._regular(information) else -np.inf

    def gradient(self, information: Array) -> Array:
        """Derivative (k, k), symmetric: value(M + E) = value(M) + tr(gradient E) + o(E) for symmetric E.

        Raises InputError when M is singular.
        """
        if not self._regular(information):
            raise InputError(
                what="it is singular: some combination of the parameters is unidentifiable",
                where="information",
                remedy="leave that combination out of the model, or start from an exciting trajectory",
            )
        gradient = np.array(_gradient(self, len(information))(information))
        return np.asarray((gradient + gradient.T) / 2)

    def graph(self, information: Any) -> Any:
        """The value as a CasADi graph over M (k, k), MX, SX or DM: no branches; M and its transpose count half each.

        Not a number where M is singular or not positive, from which an interior-point method steps back.
        """
        return _function(self, information.shape[0])(information)

    def _regular(self, information: Array) -> bool:
        return all(is_regular(block) for block in self.blocks(information))

    def __str__(self) -> str:
        return self.name


def diagonal_blocks(information: Any, sizes: Sequence[int]) -> list[Any]:
    """The diagonal blocks of M with these numbers of rows; ValueError when M is not of their sum."""
    if information.shape[0] != sum(sizes):
        raise ValueError(f"blocks of {sum(sizes)} rows were expected, and {information.shape[0]} came")
    ends = np.cumsum(sizes)
    places = [slice(int(end - size), int(end)) for end, size in zip(ends, sizes, strict=True)]
    return [information[place, place] for place in places]


@lru_cache(maxsize=64)
def _function(criterion: Criterion, size: int) -> Any:
    """The criterion as a CasADi function of a (size, size) matrix."""
    matrix = ca.SX.sym("M", size, size)
    return ca.Function("criterion", [matrix], [criterion.expression((matrix + matrix.T) / 2)])


@lru_cache(maxsize=64)
def _gradient(criterion: Criterion, size: int) -> Any:
    """Its derivative by the matrix, by automatic differentiation."""
    matrix = ca.SX.sym("M", size, size)
    return ca.Function("gradient", [matrix], [ca.gradient(_function(criterion, size)(matrix), matrix)])
