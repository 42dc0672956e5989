"""Equality-constrained least-squares step by the null-space method, and its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from estimation.least_squares.constrained.quadratic_model import QuadraticModel
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE, UNIDENTIFIABLE_SHARE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NullSpaceStep:
    """Minimise |F d - e|² subject to C d = -c, by the null-space method in the whitened parameters.

    rows, targets    F (m, k) and e (m,)
    normals, values  C (c, k) and c (c,)
    """

    local: QuadraticModel
    rows: Array
    targets: Array
    normals: Array
    values: Array

    @cached_property
    def _space(self) -> tuple[Array, Array]:
        """A particular step y that satisfies the constraints, and a basis N of their null space."""
        C = self.normals @ self.local.basis
        size = np.linalg.norm(C, axis=1)
        size[size == 0] = 1.0
        unit = C / size[:, None]
        particular = np.linalg.lstsq(unit, -self.values / size, rcond=SINGULAR_VALUE_TOLERANCE)[0]
        return np.asarray(particular), np.asarray(null_space(unit, rcond=SINGULAR_VALUE_TOLERANCE))

    @cached_property
    def _decomposed(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """SVD of F N: left vectors, singular values, right vectors, and which of them are identifiable."""
        left, singular, right = np.linalg.svd(self.rows @ self.local.basis @ self._space[1], full_matrices=False)
        return (
            left,
            singular,
            right,
            singular > SINGULAR_VALUE_TOLERANCE * max(float(singular.max(initial=0.0)), 1e-300),
        )

    @property
    def step(self) -> Array:
        """d (k,), of minimum norm along unidentifiable directions."""
        particular, free = self._space
        left, singular, right, regular = self._decomposed
        target = left.T @ (self.targets - self.rows @ (self.local.basis @ particular))
        y = particular + free @ (right[regular].T @ (target[regular] / singular[regular]))
        return np.asarray(self.local.basis @ y)

    @property
    def cost(self) -> float:
        """|F d - e|² after the step."""
        residual = self.rows @ self.step - self.targets
        return float(residual @ residual)

    @property
    def gain(self) -> float:
        """Decrease of |e|² by the step."""
        return max(float(self.targets @ self.targets) - self.cost, 0.0)

    @property
    def covariance(self) -> Array:
        """(k, k) inverse of F'F on the null space of C; unidentifiable directions get no variance."""
        _, singular, right, regular = self._decomposed
        root = self.local.basis @ self._space[1] @ (right[regular].T / singular[regular])
        return np.asarray(root @ root.T)

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """(k,) whether a parameter is identifiable with the constraints held."""
        _, _, right, regular = self._decomposed
        lost = self.local.basis @ self._space[1] @ null_space(right[regular])
        return np.asarray(np.linalg.norm(self.local.scaled_svd.scale[:, None] * lost, axis=1) < UNIDENTIFIABLE_SHARE)
