"""Optimality: the conditions of Karush, Kuhn and Tucker at a point, with the multipliers that come nearest to them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.edge import Edge, smat
from estimation.constrained.multipliers import LOST, Multipliers

Array = NDArray[np.float64]

OPTIMAL = 2e-3
"""Slope of the chi-square, per std, below which a point is its minimum: a step from there wins less than 1e-6."""

ON_THE_EDGE = 1e-9
"""How far outside the region a point may be: eigenvalues of J come out with 1e-16 of its largest, a few times over."""


@dataclass(frozen=True, eq=False)
class Optimality:
    """Multipliers of the constraints held at a point, and what is left of the optimality conditions with them.

    The gradient of chi-square and prior has to be the sum of the normals of the constraints held, each times a
    multiplier that is not negative (Z of J positive semidefinite), and the point inside the region; a constraint that
    is not held has no multiplier, so that complementarity is met by construction.
    """

    edge: Edge

    @cached_property
    def gradient(self) -> Array:
        """(k,) of chi-square and prior in the unknowns."""
        rows, targets = sum_of_squares(self.edge)
        return np.asarray(-2 * rows.T @ targets)

    @cached_property
    def _account(self) -> Multipliers:
        return Multipliers.of(self.edge, self.gradient)

    @property
    def strengths(self) -> Array:
        """(c,) multipliers in the order of the edge's normals, chi-square per std."""
        return self._account.strengths

    @property
    def multipliers(self) -> Array:
        """(c,) multipliers in the order of the edge's normals, chi-square per unit."""
        return self.strengths / self._account.sizes

    @property
    def inner(self) -> Array:
        """(rank, rank) multiplier of v' J v."""
        return smat(self.multipliers[len(self.edge.ends) :], self.edge.rank)

    @property
    def Z(self) -> Array:
        """(n, n) multiplier of J."""
        return np.asarray(self.edge.null @ self.inner @ self.edge.null.T)

    def of_ends(self, *, lower: bool) -> Array:
        """(k,) multipliers of the low or of the high ends."""
        found = np.zeros(len(self.edge.low))
        for (index, is_lower), value in zip(self.edge.ends, self.multipliers, strict=False):
            found[index] += max(value if is_lower is lower else -value, 0.0)
        return found

    @property
    def slope(self) -> float:
        """What the multipliers leave of the gradient, chi-square per std."""
        left = self.gradient - self.edge.normals.T @ self.multipliers
        return float(np.linalg.norm(self.edge.local.basis.T @ left))

    @property
    def wrong_sign(self) -> float:
        """The most negative multiplier of those that must not be, chi-square per std, as a positive number."""
        return self._account.wrong_sign(self.strengths)

    @property
    def outside(self) -> float:
        """How far the point is outside the region: of an interval in std, of J in parts of its size."""
        edge, region, theta = self.edge, self.edge.region, self.edge.local.theta
        beyond = np.maximum(region.low - theta, theta - region.high) / edge.local.spread
        return max(float(beyond.max(initial=0.0)), -float(edge.eigenvalues.min(initial=0.0)))

    @property
    def gap(self) -> float:
        """Chi-square that lies between the constraints held and the point: multipliers times distances."""
        return float(np.abs(self.multipliers) @ np.abs(self.edge.values))

    @property
    def residual(self) -> float:
        """What is left of the conditions that a Newton step mends, chi-square per std."""
        return self.slope + float(np.sqrt(self.gap))

    @property
    def exact(self) -> bool:
        """Whether nothing but rounding is left."""
        return self.residual < LOST * (1 + float(np.linalg.norm(self._account.slope)))

    @property
    def met(self) -> bool:
        """Whether the point is the minimum within rounding and the tolerance of a refit."""
        return max(self.residual, self.wrong_sign) < OPTIMAL and self.outside < ON_THE_EDGE


def sum_of_squares(edge: Edge, curved: Array | None = None) -> tuple[Array, Array]:
    """F (m, k), e (m,): chi-square and prior are |F d - e|² about the point, to second order.

    With a multiplier `curved` of v' J v, the curvature of J's edge is added.
    """
    rows, targets = edge.local.whole.root, edge.local.whole.target
    if curved is None or not edge.rank:
        return rows, targets
    bent = edge.curvature(curved)
    return np.concatenate([rows, bent]), np.concatenate([targets, np.zeros(len(bent))])
