"""Optimality criterion: a concave function of an information matrix, with its gradient and its CasADi graph."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Criterion(ABC):
    """A concave and monotone function of the information M (k, k), symmetric and positive definite.

    Every member is the logarithm of a positively homogeneous mean of M (Pukelsheim, Optimal Design of Experiments,
    chapter 5), times its `degree`: value(c M) = value(M) + degree ln c. So a difference of values does not depend on
    units: exp(difference / degree) is the factor in the number of measurements that makes up for it.
    """

    name: ClassVar[str]
    """Its name in tables."""
    unit: ClassVar[str] = "nat"

    @abstractmethod
    def value(self, information: Array) -> float:
        """The criterion at M (k, k); minus infinity when M is singular."""

    @abstractmethod
    def gradient(self, information: Array) -> Array:
        """Derivative (k, k), symmetric: value(M + E) = value(M) + tr(gradient E) + o(E) for symmetric E.

        Raises InputError when M is singular.
        """

    @abstractmethod
    def expression(self, information: Any) -> Any:
        """The value as a CasADi SX expression of M, an SX matrix that is symmetric entry by entry."""

    @abstractmethod
    def degree(self, size: int) -> float:
        """The growth of the value of a (size, size) information when M is multiplied by e."""

    def graph(self, information: Any) -> Any:
        """The value as a CasADi graph over M (k, k), MX, SX or DM: no branches; M and its transpose count half each.

        Not a number where M is singular or not positive, from which an interior-point method steps back.
        """
        return _function(self, information.shape[0])(information)

    def efficiency(self, information: Array, best: float) -> float:
        """exp((value - best) / degree): with this share of its measurements the best does as well (best: its value)."""
        return float(np.exp((self.value(information) - best) / self.degree(len(information))))

    def __str__(self) -> str:
        return self.name


@lru_cache(maxsize=64)
def _function(criterion: Criterion, size: int) -> Any:
    """The criterion as a CasADi function of a (size, size) matrix."""
    import casadi as ca

    matrix = ca.SX.sym("M", size, size)
    return ca.Function("criterion", [matrix], [criterion.expression((matrix + matrix.T) / 2)])
