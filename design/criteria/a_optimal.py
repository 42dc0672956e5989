"""A-optimality: the mean variance of the scaled parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.scaled_criterion import ScaledCriterion


@dataclass(frozen=True, eq=False)
class AOptimal(ScaledCriterion):
    """A-optimality: -ln(tr C / k), C the covariance of theta_i / scale_i.

    The RMS of the k scaled standard errors is exp(-value / 2).

    Parameters
    ----------
    scale : array (k,)
        Positive, in the parameters' units: errors of that size matter equally.

    Raises
    ------
    InputError
        For a scale that is not positive.

    Notes
    -----
    The logarithm, because 1 / tr M^-1 is concave and positively homogeneous (Pukelsheim 1993, 5.2), and the logarithm
    of such a function is concave too: the optimum is that of -tr C, and differences compare with those of D.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.AOptimal(scale=[1.0, 2.0]).value(np.diag([4.0, 1.0])), 4)
    1.3863
    """

    name = "-ln mean variance (A)"

    def expression(self, information: Any) -> Any:
        """-ln of the mean variance."""
        import casadi as ca

        return -ca.log(ca.trace(self._covariance(information)) / information.shape[0])
