"""D-optimality: the logarithm of the determinant of the information."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.criterion import Criterion
from design.criteria.symbolic_cholesky import symbolic_pivots


@dataclass(frozen=True)
class DOptimal(Criterion):
    """ln det M: the volume of the confidence ellipsoid of all parameters, which is exp(-value / 2) times a constant.

    A change of parameters theta = A eta adds 2 ln |det A| to every design alike, so that neither units nor the choice
    of parameters matters. With efficiency exp((value - best) / k) (FORMATS). Gradient M^-1.
    """

    name = "ln det M"

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the pivots."""
        import casadi as ca

        return ca.sum1(ca.log(symbolic_pivots(information)[1]))

    def degree(self, size: int) -> float:
        """k: det(c M) = c^k det M."""
        return float(size)
