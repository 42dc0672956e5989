"""D-optimality: the logarithm of the determinant of the information."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.criterion import Criterion
from design.criteria.symbolic_cholesky import symbolic_pivots


@dataclass(frozen=True)
class DOptimal(Criterion):
    """D-optimality: ln det M, M the information on all k parameters.

    The volume of their confidence ellipsoid is exp(-value / 2) times a constant.

    Notes
    -----
    A change of parameters theta = A eta adds 2 ln |det A| to every design alike, so that neither units nor the choice
    of parameters matters. The efficiency of a design is exp((value - best) / k). Gradient M^-1.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.DOptimal().value(np.diag([4.0, 1.0])), 4)
    1.3863
    """

    name = "ln det M"

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the pivots."""
        import casadi as ca

        return ca.sum1(ca.log(symbolic_pivots(information)[1]))

    def degree(self, size: int) -> float:
        """k: det(c M) = c^k det M."""
        return float(size)
