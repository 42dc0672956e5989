"""Restricted master problem over finitely many states, by a barrier method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from design.bound.dual_function import DualVariables
from design.bound.symmetry import Symmetry
from modeling.errors import InputError

Array = NDArray[np.float64]

CENTRAL_DECREMENT = 1e-2
"""Squared Newton decrement, in units of the barrier, of a central point: Newton's method converges below 1/4."""
CENTRING_STEPS = 60
"""Most Newton steps of a centring; about 10 are typical."""
CENTRING_FRACTION_TO_BOUNDARY = 0.98
"""Fraction to the boundary: share of the way to the nearest constraint that a step may go."""
ARMIJO_SHARE = 1e-4
"""Armijo's share of the predicted decrease: any small one will do."""
SHORTEST_STEP = 1e-10
"""A step as short as this no longer changes the point."""
RIDGE = 1e-12
"""Added to the scaled Newton matrix, where conditions are linearly dependent over the current states."""


@dataclass(frozen=True, eq=False)
class DualCoordinates:
    """z: the entries of D that are not zero by symmetry, then c, each scaled to about one.

    scale    (k,) of the parameters: rms of their columns
    rates    (K,) of the conditions: rms of L h
    entries  the free pairs i <= j of D
    """

    scale: Array
    rates: Array
    entries: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, gram: Array, rates: Array, symmetries: tuple[Symmetry, ...]) -> DualCoordinates:
        """From Phi'Phi (N, k, k) and L h (N, K) of states distributed over the viable set.

        Raises InputError when a parameter has no information in any state.
        """
        scale = np.sqrt(np.einsum("nii->i", gram) / len(gram))
        if not (scale > 0).all():
            what = "a parameter has no information in any state, and ln det is minus infinity for every trajectory"
            raise InputError(what=what, where="bound", remedy="leave the effect with that parameter out")
        k = len(scale)
        free = [(i, j) for i in range(k) for j in range(i, k) if _free(symmetries, i, j)]
        size = np.sqrt((rates**2).mean(axis=0))
        return cls(scale=scale, rates=np.where(size > 0, size, 1.0), entries=tuple(free))

    @cached_property
    def directions(self) -> Array:
        """E (m, k, k) with D = sum_i z_i E_i, scaled."""
        k = len(self.scale)
        out = np.zeros((len(self.entries), k, k))
        for place, (i, j) in enumerate(self.entries):
            out[place, i, j] = out[place, j, i] = 1 / (self.scale[i] * self.scale[j])
        return out

    def rows(self, gram: Array, rates: Array) -> Array:
        """J (N, m + K) with F = J z."""
        return np.hstack([np.einsum("nij,mij->nm", gram, self.directions, optimize=True), rates / self.rates])

    def start(self) -> Array:
        """z of D diagonal, c = 0."""
        diagonal = np.array([float(i == j) for i, j in self.entries])
        return np.concatenate([diagonal, np.zeros(len(self.rates))])

    def matrix(self, z: Array) -> Array:
        """D (k, k)."""
        return np.asarray(np.tensordot(z[: len(self.entries)], self.directions, axes=1))

    def dual(self, z: Array) -> DualVariables:
        """D and c."""
        return DualVariables(self.matrix(z), z[len(self.entries) :] / self.rates)


def _free(symmetries: tuple[Symmetry, ...], i: int, j: int) -> bool:
    return all(s.signs[i] * s.signs[j] > 0 for s in symmetries)


@dataclass(frozen=True, eq=False)
class RestrictedMaster:
    """minimise -ln det D over (D, c) with F(x_i) <= k at N states: rows J (N, m + K) of F = J z, and a feasible z.

    The barrier problem is: minimise -ln det D - mu sum_i ln(k - F_i). At its minimum the weights w_i = mu/(k - F_i)
    are a measure with sum w_i Phi_i'Phi_i = D^-1 and sum w_i (L h)_i = 0, and because F is linear in (D, c),
    k = sum w_i F_i = k sum w_i - N mu. So w / sum w is a measure that meets all conditions with
    ln det M = -ln det D - k ln(1 + N mu/k): a primal value, a lower bound of the dual optimum by N mu.
    """

    coordinates: DualCoordinates
    rows: Array
    z: Array

    @property
    def size(self) -> int:
        """The number of parameters k."""
        return len(self.coordinates.scale)

    @cached_property
    def slack(self) -> Array:
        """k - F_i (N,)."""
        return np.asarray(self.size - self.rows @ self.z)

    def centred(self, mu: float) -> RestrictedMaster:
        """At the minimum of the barrier problem, by Newton's method from z."""
        master = self
        for _ in range(CENTRING_STEPS):
            gradient, matrix = master._newton(mu)
            scale = 1 / np.sqrt(np.diag(matrix))
            scaled = matrix * scale * scale[:, None] + RIDGE * np.eye(len(scale))
            step = -scale * cho_solve(cho_factor(scaled), scale * gradient)
            decrement = -float(gradient @ step)
            master = master._line_search(step, decrement, mu)
            if decrement < CENTRAL_DECREMENT * mu:
                break
        return master

    def weights(self, mu: float) -> Array:
        """w_i (N,) at the minimum of the barrier problem."""
        return np.asarray(mu / self.slack)

    def joined(self, rows: Array, retained: NDArray[np.intp]) -> RestrictedMaster:
        """With more states, and the `retained` of its own; z is scaled so that it is feasible again."""
        joined = np.vstack([self.rows[retained], rows])
        largest = float((joined @ self.z).max())
        factor = min(1.0, CENTRING_FRACTION_TO_BOUNDARY * self.size / largest)
        return replace(self, rows=joined, z=self.z * factor)

    def _newton(self, mu: float) -> tuple[Array, Array]:
        """Gradient and Hessian of the barrier problem."""
        m, directions = len(self.coordinates.entries), self.coordinates.directions
        solved = np.linalg.solve(self.coordinates.matrix(self.z), directions)
        weights = mu / self.slack
        gradient = self.rows.T @ weights
        gradient[:m] -= np.einsum("mii->m", solved)
        weighted = self.rows * (weights / np.sqrt(mu))[:, None]
        matrix = weighted.T @ weighted
        matrix[:m, :m] += np.einsum("aij,bji->ab", solved, solved)
        return gradient, matrix

    def _barrier(self, mu: float, z: Array, slack: Array) -> float:
        D = self.coordinates.matrix(z)
        if slack.min() <= 0 or np.linalg.eigvalsh(D)[0] <= 0:
            return np.inf
        return float(-np.linalg.slogdet(D)[1] - mu * np.log(slack).sum())

    def _line_search(self, step: Array, decrement: float, mu: float) -> RestrictedMaster:
        """The longest of t, t/2, t/4 .. of the step that is feasible, with Armijo decrease."""
        change, before = self.rows @ step, self._barrier(mu, self.z, self.slack)
        shrinking = np.maximum(change, 0) / self.slack
        length = min(1.0, CENTRING_FRACTION_TO_BOUNDARY / max(float(shrinking.max()), 1e-300))
        while length > SHORTEST_STEP:
            z = self.z + length * step
            if self._barrier(mu, z, self.slack - length * change) <= before - ARMIJO_SHARE * length * decrement:
                return replace(self, z=z)
            length /= 2
        return self
