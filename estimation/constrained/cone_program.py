"""Cone program: least squares within intervals and the cone of consistent tools, by CVXPY and Clarabel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.local_model import LocalModel
from estimation.constrained.region import Region
from estimation.constrained.solver import cvxpy, solved

Array = NDArray[np.float64]

UNSHOWN_PULL = 1e-6
"""Weight that keeps unknowns which the data do not show near where they are: too little to move those they do."""
OUT_OF_REACH = 1e4
"""Lengths of a step beyond which an end is left out: it would only blunt the solver, and the next step sees it."""


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """The unknowns (k,) and multipliers: of each low and high end, (k,), in chi-square per unit, and of J, Z (n, n)."""

    theta: Array
    low: Array
    high: Array
    Z: Array


@dataclass(frozen=True, eq=False)
class ConeProgram:
    """Minimise |R d - z|² + prior + damping |y|² over the region, d = B y, B of the local model.

    In y the chi-square has unit curvature. The program is in u = y / length, with the objective over length², each
    interval over its unknown's std and the length, and J brought to unit size: whatever the units, and however far the
    region, the solver sees numbers about 1.
    """

    local: LocalModel
    region: Region
    damping: float

    @cached_property
    def u(self) -> Any:
        """CVXPY's variable (k,)."""
        return cvxpy().Variable(len(self.local.theta))

    @cached_property
    def length(self) -> float:
        """How far, in std, the free minimum and the region are, and 1."""
        local, region = self.local, self.region
        beyond = np.maximum(region.low - local.theta, local.theta - region.high) / local.spread
        values, vectors = np.linalg.eigh(region.matrix(local.theta) / np.outer(*[size_of(local, region)] * 2))
        inner = vectors / size_of(local, region)[:, None]
        sizes = np.linalg.norm(np.einsum("na,knm,ma->ak", inner, region.slopes, inner) @ local.basis, axis=1)
        below = -values / np.where(sizes > 0, sizes, 1.0)
        return 1 + float(np.linalg.norm(local.reach)) + float(max(beyond.max(initial=0.0), below.max(initial=0.0)))

    @property
    def _whole(self) -> float:
        """What the objective is divided by."""
        return self.length**2 + (0.0 if self.region.prior is None else self.region.prior.weight)

    def _objective(self) -> Any:
        cp, local = cvxpy(), self.local
        squares = cp.sum_squares((local.data.root @ local.basis) @ self.u - local.data.target / self.length)
        held = np.sqrt(self.damping + np.where(local.seen, 0.0, UNSHOWN_PULL))
        objective = self.length**2 / self._whole * (squares + cp.sum_squares(cp.multiply(held, self.u)))
        prior = self.region.prior
        if prior is None:
            return objective
        X = self._moved(prior.inertia.at(local.theta), prior.inertia.slopes, prior.whitening)
        return objective + prior.weight / self._whole * (cp.trace(X) - cp.log_det(X))

    def _end(self, *, lower: bool) -> tuple[Any, NDArray[np.intp]]:
        """The condition of the low or high ends that a step can reach, and whose they are."""
        local, region = self.local, self.region
        slack = (local.theta - region.low if lower else region.high - local.theta) / local.spread / self.length
        kept = np.flatnonzero(slack < OUT_OF_REACH)
        move = (local.basis[kept] / local.spread[kept, None]) @ self.u if kept.size else np.zeros(0)
        return (slack[kept] + move if lower else slack[kept] - move) >= 0, kept

    def _moved(self, matrix: Array, slopes: Array, outer: Array) -> Any:
        """outer J(theta + B y) outer', symmetric, as a CVXPY expression."""
        n = len(matrix)
        turned = (outer @ slopes @ outer.T).reshape(len(slopes), -1).T @ self.local.basis * self.length
        return outer @ matrix @ outer.T + cvxpy().reshape(turned @ self.u, (n, n), order="C")

    def solve(self) -> ConeSolution | None:
        """The solution, None when the solver gives up."""
        cp, local, region = cvxpy(), self.local, self.region
        ends = [self._end(lower=lower) for lower in (True, False)]
        conditions = [condition for condition, kept in ends if kept.size]
        scale = size_of(local, region, self.length)
        cone = self._moved(region.matrix(local.theta), region.slopes, np.diag(1 / scale)) >> 0 if scale.size else None
        if not solved(cp.Problem(cp.Minimize(self._objective()), conditions + ([] if cone is None else [cone]))):
            return None
        theta = np.clip(local.theta + local.basis @ self.u.value * self.length, region.low, region.high)
        Z = np.zeros((0, 0)) if cone is None else self._whole * cone.dual_value / np.outer(scale, scale)
        low, high = (self._multiplier(condition, kept) for condition, kept in ends)
        return ConeSolution(theta, low, high, Z)

    def _multiplier(self, condition: Any, kept: NDArray[np.intp]) -> Array:
        found = np.zeros(len(self.local.theta))
        if kept.size:
            found[kept] = self._whole * condition.dual_value / self.local.spread[kept] / self.length
        return found


def size_of(local: LocalModel, region: Region, length: float = 1.0) -> Array:
    """Square roots (n,) of the size of J's diagonal: its value, or what `length` std of the unknowns make of it."""
    diagonal = np.abs(np.diag(region.matrix(local.theta)))
    shifts = length * np.linalg.norm(np.diagonal(region.slopes, axis1=1, axis2=2).T @ local.basis, axis=1)
    return np.asarray(np.sqrt(np.maximum(np.maximum(diagonal, shifts), 1e-300)))
