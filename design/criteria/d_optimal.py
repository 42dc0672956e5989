"""D-optimality: the logarithm of the determinant of the information."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from design.criteria.cholesky import CholeskyFactor, symbolic_pivots
from design.criteria.criterion import Array, Criterion


@dataclass(frozen=True)
class DOptimal(Criterion):
    """ln det M: the volume of the confidence ellipsoid of all parameters, which is exp(-value / 2) times a constant.

    A change of parameters theta = A eta adds 2 ln |det A| to every design alike, so that neither units nor the choice
    of parameters matters. With efficiency exp((value - best) / k) (FORMATS). Gradient M^-1.
    """

    name = "ln det M"

    def value(self, information: Array) -> float:
        """ln det M by Cholesky."""
        factor = CholeskyFactor.of(information)
        return float(factor.log_pivots.sum()) if factor is not None else -np.inf

    def gradient(self, information: Array) -> Array:
        """M^-1."""
        return CholeskyFactor.required(information).inverse

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the pivots."""
        import casadi as ca

        return ca.sum1(ca.log(symbolic_pivots(information)[1]))

    def degree(self, size: int) -> float:
        """k: det(c M) = c^k det M."""
        return float(size)
