"""Robust losses that downweight large residuals: Huber's and Student's t."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from modeling.errors import InputError

Array = NDArray[np.float64]

NORMAL_INTEGRATION_LIMIT = 9.0
"""Integration limit, in std, of means over the normal distribution: the tail beyond, 2e-19, is below rounding."""


class Loss(ABC):
    """Robust loss of a residual u, in units of the noise's robust std, by its influence function psi.

    An M-estimator makes sum psi(u) x vanish where least squares make sum u x vanish. psi is odd, with slope 1 at zero:
    small residuals count as in least squares. Derivation of the figures below: P. J. Huber, "Robust estimation of a
    location parameter", Ann. Math. Statist. 35 (1964) 73-101.
    """

    @abstractmethod
    def psi(self, u: Array) -> Array:
        """Influence function psi(u), elementwise."""

    @abstractmethod
    def slope(self, u: Array) -> Array:
        """Derivative of psi, elementwise."""

    @abstractmethod
    def weight(self, u: Array) -> Array:
        """psi(u) / u, elementwise; 1 at zero."""

    @property
    @abstractmethod
    def corners(self) -> tuple[float, ...]:
        """Where u > 0 psi is not smooth."""

    @property
    def efficiency(self) -> float:
        """Variance of least squares over that with this loss under white normal noise: (E psi')² / E psi²."""
        return self.normal_mean(self.slope) ** 2 / self.normal_mean(lambda u: self.psi(u) ** 2)

    @property
    def downweighted(self) -> float:
        """Mean of 1 - weight under normal noise: the share downweighted without any outlier."""
        return self.normal_mean(lambda u: 1.0 - self.weight(u))

    def normal_mean(self, function: Callable[[Array], Array]) -> float:
        """Mean of an even function under the standard normal law, by Gauss-Legendre quadrature between corners."""
        nodes, weights = leggauss(80)
        edges = np.array([0.0, *self.corners, NORMAL_INTEGRATION_LIMIT])
        half = np.diff(edges)[:, None] / 2
        u = (edges[:-1, None] + half * (1 + nodes)).ravel()
        density = np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi)
        return float(2 * np.sum((half * weights).ravel() * function(u) * density))


@dataclass(frozen=True)
class Huber(Loss):
    """Huber's loss: squares within ±k, absolute values outside.

    Parameters
    ----------
    k : float, optional
        Corner of psi, in units of the noise's robust std; by default 1.345, which is 95 % efficient.

    Raises
    ------
    InputError
        Unless k is positive.

    Notes
    -----
    psi = u up to k and ±k beyond.

    Examples
    --------
    >>> import truewrench as tw
    >>> loss = tw.Huber()
    >>> print(f"{loss.efficiency:.2f}")
    0.95
    >>> tw.Huber(k=2.0).psi([-3.0, 0.5, 10.0]).tolist()
    [-2.0, 0.5, 2.0]
    """

    k: float = 1.345

    def __post_init__(self) -> None:
        _require_positive("Huber(k=)", self.k)

    def psi(self, u: Array) -> Array:
        """u within ±k."""
        return np.clip(u, -self.k, self.k)

    def slope(self, u: Array) -> Array:
        """1 within, 0 beyond."""
        return np.where(np.abs(u) <= self.k, 1.0, 0.0)

    def weight(self, u: Array) -> Array:
        """min(1, k / |u|)."""
        return self.k / np.maximum(np.abs(u), self.k)

    @property
    def corners(self) -> tuple[float, ...]:
        """k."""
        return (self.k,)


@dataclass(frozen=True)
class StudentT(Loss):
    """The score of Student's t, redescending: the influence of far outliers vanishes.

    Parameters
    ----------
    freedom : float, optional
        Degrees of freedom, by default 4.

    Raises
    ------
    InputError
        Unless `freedom` is positive.

    Notes
    -----
    psi = u / (1 + u² / freedom). Maximum likelihood for t noise whose scale is the unit of u.

    Examples
    --------
    >>> import truewrench as tw
    >>> loss = tw.StudentT(freedom=4.0)
    >>> [round(float(loss.psi(u)), 2) for u in (0.1, 2.0, 20.0)]
    [0.1, 1.0, 0.2]
    """

    freedom: float = 4.0

    def __post_init__(self) -> None:
        _require_positive("StudentT(freedom=)", self.freedom)

    def psi(self, u: Array) -> Array:
        """u times its weight."""
        return np.asarray(u * self.weight(u))

    def slope(self, u: Array) -> Array:
        """(1 - u²/freedom) / (1 + u²/freedom)²: negative beyond the root of `freedom`."""
        weight = self.weight(u)
        return np.asarray(weight * (2 * weight - 1))

    def weight(self, u: Array) -> Array:
        """1 / (1 + u² / freedom)."""
        return np.asarray(1 / (1 + u**2 / self.freedom))

    @property
    def corners(self) -> tuple[float, ...]:
        """None."""
        return ()


def _require_positive(where: str, value: float) -> None:
    if not value > 0:
        raise InputError(what=f"it is {value:g}", where=where, remedy="give a positive number")
