"""Log-det (Bregman) divergence of a tool's pseudo-inertia from a reference, as a prior."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modeling.chain.pseudo_inertia import PseudoInertia

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LogDetDivergence:
    """weight · D(J || J_0), the Bregman divergence of -log det, as a term of the chi-square.

    With J_0 = L L' and the tool in whitened coordinates, X = L^-1 J L^-T,

        D = tr(X) - log det X - n,    0 at J = J_0, infinite at the boundary of physical consistency.

    It is twice the relative entropy of the normal distribution of covariance J to that of J_0. A change of units or of
    frame, J to T J T', leaves the eigenvalues of X unchanged, and so D. For X = 1 + E it is sum_ij E_ij² / 2 to second
    order: a relative std of sqrt(2 / weight) of each of the whitened moments.
    Wensing, Kim, Slotine (2018); Lee, Wensing, Park, "Geometric robot dynamic identification: a convex programming
    approach" (IEEE Transactions on Robotics 36, 2020).

    reference  J_0 (n, n), positive definite
    """

    inertia: PseudoInertia
    reference: Array
    weight: float

    @cached_property
    def whitening(self) -> Array:
        """L^-1 (n, n)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.reference)))

    def whitened(self, matrix: Array) -> Array:
        """L^-1 (.) L^-T of one matrix (n, n) or several (k, n, n)."""
        return np.asarray(self.whitening @ matrix @ self.whitening.T)

    def value(self, theta: Array) -> float:
        """weight · D at the parameters theta (k,); infinite where J is not positive definite."""
        eigenvalues = np.linalg.eigvalsh(self.whitened(self.inertia.at(theta)))
        if eigenvalues.min() <= 0:
            return np.inf
        excess = eigenvalues - 1
        return float(self.weight * np.sum(excess - np.log1p(excess)))

    def rows(self, theta: Array) -> tuple[Array, Array]:
        """F (n², k) and e (n²,) with weight · D(theta + d) = |F d - e|² + constant to second order in d.

        The gradient of D is <1 - X^-1, X_i> and its Hessian <X^-1/2 X_i X^-1/2, X^-1/2 X_j X^-1/2>, X_i the whitened
        slopes: F_i = sqrt(weight/2) X^-1/2 X_i X^-1/2 and e = sqrt(weight/2) (1 - X) give both.
        """
        eigenvalues, vectors = np.linalg.eigh(self.whitened(self.inertia.at(theta)))
        half = vectors / np.sqrt(eigenvalues) @ vectors.T
        columns = half @ self.whitened(self.inertia.slopes) @ half
        target = np.eye(len(half)) - vectors * eigenvalues @ vectors.T
        factor = np.sqrt(self.weight / 2)
        return factor * columns.reshape(len(columns), -1).T, factor * target.ravel()
