"""Tangent: least squares along the constraints that are held, its step and its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.local_model import LocalModel
from estimation.linear.descent import UNSHOWN
from estimation.linear.least_squares import PART

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tangent:
    """|F d - e|² over the steps d that keep C d = -c: null-space method in the whitened unknowns.

    rows, targets    F (m, k) and e (m,)
    normals, values  C (c, k) and c (c,)
    """

    local: LocalModel
    rows: Array
    targets: Array
    normals: Array
    values: Array

    @cached_property
    def _space(self) -> tuple[Array, Array]:
        """A step y that returns to the constraints, and a basis N of those that stay on them."""
        k = len(self.local.theta)
        C = self.normals @ self.local.basis
        if not C.size:
            return np.zeros(k), np.eye(k)
        size = np.linalg.norm(C, axis=1)
        size[size == 0] = 1.0
        left, singular, right = np.linalg.svd(C / size[:, None])
        rank = int(np.sum(singular > UNSHOWN * singular.max()))
        back = right[:rank].T @ (left[:, :rank].T @ (-self.values / size) / singular[:rank])
        return np.asarray(back), np.asarray(right[rank:].T)

    @cached_property
    def _decomposed(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """The singular values of F along N, left and right vectors, and which of them the data show."""
        left, singular, right = np.linalg.svd(self.rows @ self.local.basis @ self._space[1], full_matrices=False)
        return left, singular, right, singular > UNSHOWN * max(float(singular.max(initial=0.0)), 1e-300)

    @property
    def step(self) -> Array:
        """d (k,), the shortest where the data leave it open."""
        back, along = self._space
        left, singular, right, shown = self._decomposed
        target = left.T @ (self.targets - self.rows @ (self.local.basis @ back))
        y = back + along @ (right[shown].T @ (target[shown] / singular[shown]))
        return np.asarray(self.local.basis @ y)

    @property
    def cost(self) -> float:
        """|F d - e|² after the step."""
        left = self.rows @ self.step - self.targets
        return float(left @ left)

    @property
    def gain(self) -> float:
        """By how much the step lowers |e|²."""
        return max(float(self.targets @ self.targets) - self.cost, 0.0)

    @property
    def covariance(self) -> Array:
        """(k, k) inverse of F'F along the tangent; directions that the data do not show get no variance."""
        _, singular, right, shown = self._decomposed
        root = self.local.basis @ self._space[1] @ (right[shown].T / singular[shown])
        return np.asarray(root @ root.T)

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(k,) whether the data, with the constraints held, tell an unknown apart."""
        _, _, right, shown = self._decomposed
        beyond = self.local.basis @ self._space[1] @ _complement(right[shown], self._space[1].shape[1])
        return np.asarray(np.linalg.norm(self.local.sight.scale[:, None] * beyond, axis=1) < PART)


def _complement(rows: Array, size: int) -> Array:
    """An orthonormal basis (size, .) of what is orthogonal to orthonormal rows (r, size)."""
    full = np.linalg.svd(np.concatenate([rows, np.zeros((1, size))]))[2]
    return np.asarray(full[len(rows) :].T)
