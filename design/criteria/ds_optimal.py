"""D_s-optimality: information on a subset of parameters, the others nuisance (Schur complement)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from design.criteria.cholesky import CholeskyFactor, symbolic_pivots
from design.criteria.criterion import Array, Criterion
from modeling.chain.model import WrenchModel
from modeling.errors import InputError


@dataclass(frozen=True)
class Subset(Criterion):
    """ln det of the information on some parameters with all others free: ln det M - ln det M_nn = ln det of the Schur
    complement M_ss - M_sn M_nn^-1 M_ns, n the nuisance parameters (Atkinson, Donev and Tobias 2007, section 10.3).

    `indices` are those of the s parameters of interest. The criterion is invariant, up to a constant, under regular
    linear maps of the nuisance parameters and of the parameters of interest among themselves. Gradient
    M^-1 - diag(0, M_nn^-1).
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

    @classmethod
    def of_effects(cls, model: WrenchModel, ids: Sequence[str]) -> Self:
        """The parameters of the effects with these ids; InputError when the model has none of them."""
        owned = tuple(i for i, p in enumerate(model.parameters) if p.name.partition(".")[0] in ids and "." in p.name)
        if not owned:
            known = ", ".join(e.id for e in model.effects) or "none"
            raise InputError(
                what=f"the model has no parameters of {', '.join(ids)}", where="subset", remedy=f"its effects: {known}"
            )
        return cls(owned)

    def value(self, information: Array) -> float:
        """Sum of the last s logarithms of pivots, the nuisance parameters ordered first."""
        order = self._order(len(information))
        factor = CholeskyFactor.of(information[np.ix_(order, order)])
        return float(factor.log_pivots[-len(self.indices) :].sum()) if factor else -np.inf

    def gradient(self, information: Array) -> Array:
        """M^-1 minus the inverse of the nuisance block."""
        nuisance = self._order(len(information))[: -len(self.indices)]
        gradient = CholeskyFactor.required(information).inverse
        if nuisance:
            block = np.ix_(nuisance, nuisance)
            gradient[block] -= CholeskyFactor.required(information[block]).inverse
        return gradient

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
