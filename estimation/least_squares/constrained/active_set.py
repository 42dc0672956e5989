"""Active set at a point: bounds and zero eigenvalues of the pseudo-inertia, their normals and curvature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.cone_program import ConeSolution, inertia_scale
from estimation.least_squares.constrained.quadratic_model import QuadraticModel
from estimation.least_squares.constraints.feasible_region import FeasibleRegion

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ACTIVE_DISTANCE = 1e-6
"""Distance, in std, below which a solution of the cone program counts as on a constraint."""


@dataclass(frozen=True, eq=False)
class ActiveSet:
    """The constraints held as equalities at the point of a quadratic model.

    low, high  (k,) active bounds; a fixed parameter is held at its lower one
    rank       number of eigenvalues of J held at zero
    solution   of the cone program that found this active set, if one did

    J is scaled to unit size, T J T with T diagonal. With the vectors v_a = T V_a of its `rank` smallest eigenvalues,
    J has that many zeros exactly when V'(TJT)V - V'(TJT)U (U'TJT U)^-1 U'(TJT)V = 0, U the other eigenvectors (Schur
    complement). At the point itself U'TJT V = 0, so that the first order of this is v_a' J v_b, and the second
    -v_a' dJ J^+ dJ v_b with J^+ = T U D^-1 U' T.
    """

    region: FeasibleRegion
    local: QuadraticModel
    low: BoolArray
    high: BoolArray
    rank: int = 0
    solution: ConeSolution | None = None

    @classmethod
    def touched(cls, region: FeasibleRegion, local: QuadraticModel) -> Self:
        """The bounds at which the point lies exactly."""
        return cls(region, local, local.theta <= region.low, (local.theta >= region.high) & ~region.fixed)

    @classmethod
    def of_solution(cls, region: FeasibleRegion, local: QuadraticModel, solution: ConeSolution) -> Self:
        """Active set of a cone program's solution: where, in std, the multiplier exceeds the slack."""
        spread, theta = local.spread, solution.theta
        low = _is_active((theta - region.low) / spread, solution.low * spread) | region.fixed
        high = _is_active((region.high - theta) / spread, solution.high * spread) & ~region.fixed
        full = cls(region, replace(local, theta=theta), low, high, len(solution.Z), solution)
        sizes = np.linalg.norm(full.forms @ local.basis, axis=1)
        sizes[sizes == 0] = 1.0
        dual = np.einsum("na,nm,ma->a", full.dual_vectors, solution.Z, full.dual_vectors)
        return replace(full, rank=int(_is_active(full.eigenvalues / sizes, dual * sizes).sum()))

    def at(self, local: QuadraticModel) -> ActiveSet:
        """The same constraints about another point."""
        return replace(self, local=local)

    @cached_property
    def scale(self) -> Array:
        """(n,) the diagonal of T^-1."""
        return inertia_scale(self.local, self.region)

    @cached_property
    def _eigen(self) -> tuple[Array, Array]:
        matrix = self.region.matrix(self.local.theta) / np.outer(self.scale, self.scale)
        values, vectors = np.linalg.eigh(matrix)
        return values, vectors

    @property
    def eigenvalues(self) -> Array:
        """(n,) of T J T, ascending."""
        return self._eigen[0]

    @property
    def null(self) -> Array:
        """(n, rank) vectors v whose v' J v is held at zero."""
        return self._eigen[1][:, : self.rank] / self.scale[:, None]

    @property
    def dual_vectors(self) -> Array:
        """(n, rank) T^-1 V: a multiplier Z of J has V_a' (T^-1 Z T^-1) V_b in the coordinates of T J T."""
        return self._eigen[1][:, : self.rank] * self.scale[:, None]

    @property
    def guess(self) -> Array:
        """(c,) multipliers of the normals from the cone program."""
        if self.solution is None:
            return np.zeros(len(self.normals))
        ends = [(self.solution.low if lower else self.solution.high)[i] for i, lower in self.ends]
        return np.concatenate([ends, svec(self.dual_vectors.T @ self.solution.Z @ self.dual_vectors)])

    @property
    def forms(self) -> Array:
        """(rank, k) derivative of each v_a' J v_a."""
        return np.asarray(np.einsum("na,knm,ma->ak", self.null, self.region.slopes, self.null))

    @property
    def ends(self) -> list[tuple[int, bool]]:
        """(index, lower) of each active bound, in the order of the normals."""
        return [(int(i), True) for i in np.flatnonzero(self.low)] + [(int(i), False) for i in np.flatnonzero(self.high)]

    @property
    def sign_free(self) -> BoolArray:
        """(c,) normals whose multiplier may have either sign: those of fixed parameters."""
        return np.array([self.region.fixed[i] for i, _ in self.ends] + [False] * svec_size(self.rank), dtype=bool)

    @cached_property
    def normals(self) -> Array:
        """(c, k) derivative of each constraint's value, positive inwards: the bounds, then svec(v' J v)."""
        k = len(self.low)
        ends = np.array([np.eye(k)[i] * (1 if lower else -1) for i, lower in self.ends]).reshape(-1, k)
        moments = self.null.T @ self.region.slopes @ self.null
        return np.concatenate([ends, np.array([svec(m) for m in moments]).reshape(k, -1).T])

    @cached_property
    def values(self) -> Array:
        """(c,) values of the constraints at the point, positive inside."""
        theta, region = self.local.theta, self.region
        ends = [theta[i] - region.low[i] if lower else region.high[i] - theta[i] for i, lower in self.ends]
        return np.concatenate([ends, svec(self.null.T @ region.matrix(theta) @ self.null)])

    def curvature(self, multiplier: Array) -> Array:
        """(n rank, k) rows F: |F d|² is the curvature term of the Lagrangian at a multiplier (rank, rank) of v' J v.

        Along the boundary of the cone v' J v grows by v' dJ J^+ dJ v, which adds tr(multiplier v' dJ J^+ dJ v).
        """
        values, vectors = np.linalg.eigh(multiplier)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        others = self._eigen[1][:, self.rank :] / np.sqrt(np.maximum(self.eigenvalues[self.rank :], 1e-300))
        rows = (others / self.scale[:, None]).T @ self.region.slopes @ self.null @ root
        return np.asarray(rows.reshape(len(self.low), -1).T)


def _is_active(slack: Array, multiplier: Array) -> BoolArray:
    return np.asarray((slack < ACTIVE_DISTANCE) | (slack < multiplier))


def svec_size(rank: int) -> int:
    """Entries of the `svec` of a symmetric matrix (rank, rank)."""
    return rank * (rank + 1) // 2


def svec(matrix: Array) -> Array:
    """The upper triangle (r (r + 1) / 2,) of a symmetric matrix, scaled to preserve inner products."""
    rows, columns = np.triu_indices(len(matrix))
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def smat(vector: Array, size: int) -> Array:
    """The symmetric matrix (size, size) of an `svec`."""
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = vector / np.where(rows == columns, 1.0, np.sqrt(2.0))
    return matrix + np.triu(matrix, 1).T
