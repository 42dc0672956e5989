"""Ds-optimality: the parameters that one asks about, whatever the others are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from design.criterion.criterion import Array, Criterion
from design.criterion.triangle import Triangle, symbolic_pivots
from modeling.errors import InputError
from modeling.model import WrenchModel


@dataclass(frozen=True)
class Subset(Criterion):
    """ln det of the information on some parameters with all others free: ln det M - ln det M_nn = ln det of the Schur
    complement M_ss - M_sn M_nn^-1 M_ns, n the nuisance parameters (Atkinson, Donev and Tobias 2007, section 10.3).

    `indices` are the places of the s parameters asked about. What the others are called and in what combinations they
    are taken does not matter; the s may be combined among each other, and any multiple of the others be added to
    the others. Gradient M^-1 - diag(0, M_nn^-1).
    """

    indices: tuple[int, ...]

    name = "ln det of a subset (Ds)"

    def __post_init__(self) -> None:
        if not self.indices or len(set(self.indices)) < len(self.indices) or min(self.indices) < 0:
            raise InputError(
                what=f"{self.indices} are no places of different parameters", where="subset", remedy="name at least one"
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
        """Sum of the last s logarithms of pivots, the nuisance parameters before."""
        order = self._order(len(information))
        triangle = Triangle.of(information[np.ix_(order, order)])
        return float(triangle.log_pivots[-len(self.indices) :].sum()) if triangle else -np.inf

    def gradient(self, information: Array) -> Array:
        """M^-1 less the inverse of its nuisance block."""
        nuisance = self._order(len(information))[: -len(self.indices)]
        gradient = Triangle.required(information).inverse
        if nuisance:
            block = np.ix_(nuisance, nuisance)
            gradient[block] -= Triangle.required(information[block]).inverse
        return gradient

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the last s pivots."""
        import casadi as ca

        order = self._order(information.shape[0])
        pivots = symbolic_pivots(information[order, order])[1]
        return ca.sum1(ca.log(pivots[-len(self.indices) :, 0]))

    def degree(self, size: int) -> float:
        """The number s of parameters asked about."""
        return float(len(self.indices))

    def _order(self, size: int) -> list[int]:
        """The nuisance parameters, then the others."""
        if max(self.indices) >= size:
            raise ValueError(f"parameter {max(self.indices)} was asked about, of {size}")
        return [i for i in range(size) if i not in self.indices] + list(self.indices)
