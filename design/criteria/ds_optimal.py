"""D_s-optimality: information on a subset of parameters, the others nuisance (Schur complement)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.criterion import Criterion
from design.criteria.symbolic_cholesky import symbolic_pivots
from modeling.errors import InputError


@dataclass(frozen=True)
class Subset(Criterion):
    """Ds-optimality: ln det of the information on some parameters with all others free.

    Parameters
    ----------
    indices : tuple of int
        Positions, from 0, of the s parameters of interest; all others are nuisance parameters.

    Raises
    ------
    InputError
        When there is no position, or one is negative or given twice.

    Notes
    -----
    ln det M - ln det M_nn = ln det of the Schur complement M_ss - M_sn M_nn^-1 M_ns, n the nuisance parameters
    (Atkinson, Donev and Tobias 2007, section 10.3). It is invariant, up to a constant, under regular linear maps of the
    nuisance parameters and of the parameters of interest among themselves. Gradient M^-1 - diag(0, M_nn^-1).

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.Subset(indices=(0,)).value(np.array([[4.0, 1.0], [1.0, 1.0]])), 4)
    1.0986
    """

    indices: tuple[int, ...]

    name = "ln det of a subset (D_s)"

    def __post_init__(self) -> None:
        if not self.indices or len(set(self.indices)) < len(self.indices) or min(self.indices) < 0:
            raise InputError(
                what=f"{self.indices} are not indices of different parameters",
                where="subset",
                remedy="give at least one index, from 0, and each once",
            )

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the last s pivots."""
        import casadi as ca

        order = self._order(information.shape[0])
        pivots = symbolic_pivots(information[order, order])[1]
        return ca.sum1(ca.log(pivots[-len(self.indices) :, 0]))

    def degree(self, size: int) -> float:
        """The number s of parameters of interest."""
        return float(len(self.indices))

    def _order(self, size: int) -> list[int]:
        """The nuisance parameters, then those of interest."""
        if max(self.indices) >= size:
            raise ValueError(f"indices below {size} were expected, and {max(self.indices)} came")
        return [i for i in range(size) if i not in self.indices] + list(self.indices)
