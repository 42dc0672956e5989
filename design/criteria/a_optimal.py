"""A-optimality: the mean variance of the scaled parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from design.criteria.cholesky import CholeskyFactor
from design.criteria.criterion import Array
from design.criteria.scaled_criterion import ScaledCriterion


@dataclass(frozen=True, eq=False)
class AOptimal(ScaledCriterion):
    """-ln(tr C / k), C the covariance of theta_i / scale_i: the RMS of the scaled standard errors is exp(-value / 2).

    The logarithm, because 1 / tr M^-1 is concave and positively homogeneous (Pukelsheim 1993, 5.2), and the logarithm
    of such a function is concave too: the optimum is that of -tr C, and differences compare with those of D.
    With Z = diag(scale) and c = C Z: d tr C = -tr(c' c dM), so the gradient is c' c / tr C.
    """

    name = "-ln mean variance (A)"

    def value(self, information: Array) -> float:
        """-ln of the mean variance."""
        factor = CholeskyFactor.of(information)
        return -float(np.log(np.trace(self._covariance(factor)) / len(information))) if factor else -np.inf

    def gradient(self, information: Array) -> Array:
        """Z C C Z over tr C, where M^-1 = Z C Z."""
        covariance = self._covariance(CholeskyFactor.required(information))
        weighted = covariance * self.scale
        return np.asarray(weighted.T @ weighted / np.trace(covariance))

    def expression(self, information: Any) -> Any:
        """-ln of the mean variance."""
        import casadi as ca

        return -ca.log(ca.trace(self._symbolic_covariance(information)) / information.shape[0])
