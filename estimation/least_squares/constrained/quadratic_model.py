"""Quadratic model of chi-square and prior about a point, in whitened parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constraints.log_det_divergence import LogDetDivergence
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.parameter_layout import ParameterLayout
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE, ScaledSVD

Array = NDArray[np.float64]


class LeastSquaresProblem(Protocol):
    """A least-squares problem that can be constrained; `WhitenedProblem` is one."""

    @property
    def layout(self) -> ParameterLayout:
        """Its parameters."""

    def information(self, theta: Array, /) -> SquareRootInformation:
        """Square-root information of the whitened rows on a step from theta (k,)."""

    def minimise(self, start: Array, /) -> LeastSquaresMinimum:
        """The minimum within the parameters' own bounds alone."""


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """Chi-square and prior of theta + d, |R d - z|² + power to second order for a linearised prediction.

    theta  (k,)
    data   the rows of the recordings about theta
    whole  with those of the prior, where there is one and the tool is physically consistent
    """

    theta: Array
    data: SquareRootInformation
    whole: SquareRootInformation

    @classmethod
    def at(cls, problem: LeastSquaresProblem, theta: Array, prior: LogDetDivergence | None) -> Self:
        """The problem about theta."""
        data = problem.information(theta)
        if prior is None or not np.isfinite(prior.value(theta)):
            return cls(theta, data, data)
        return cls(theta, data, data + SquareRootInformation.of(*prior.rows(theta)))

    @property
    def cost(self) -> float:
        """The chi-square of the data at theta."""
        return self.data.cost

    @cached_property
    def scaled_svd(self) -> ScaledSVD:
        """Scaled SVD of the information of data and prior."""
        return ScaledSVD.of(self.whole.root, SINGULAR_VALUE_TOLERANCE)

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """(k,) which of the whitened parameters y are identifiable."""
        return self.scaled_svd.regular

    @cached_property
    def basis(self) -> Array:
        """B (k, k) of d = B y, with |R d - z|² = |y - reach|² + constant over the identifiable y."""
        scaled_svd = self.scaled_svd
        return np.asarray(
            scaled_svd.right.T / np.where(scaled_svd.regular, scaled_svd.singular, 1.0) / scaled_svd.scale[:, None]
        )

    @cached_property
    def reach(self) -> Array:
        """(k,) y of the quadratic model's unconstrained minimum, 0 along the null space."""
        return np.where(self.identifiable, self.scaled_svd.left.T @ self.whole.target, 0.0)

    @cached_property
    def spread(self) -> Array:
        """(k,) size of each parameter in y: its std, where it is identifiable."""
        return np.asarray(np.linalg.norm(self.basis, axis=1))
