"""Equilibrium: the equation that the bend obeys at each sample, compiled, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """F (d,) as a CasADi graph over the symbols it is made of.

    u (m,) the signals; bend (3 d,) angles, rates and accelerations of the bend, in this order; theta (k,) parameters.
    """

    graph: Any
    u: Any
    bend: Any
    theta: Any

    @property
    def size(self) -> int:
        """The number d of angles."""
        return int(self.graph.numel())

    def at(self, signals: Array, bend: Array, theta: Array) -> tuple[Array, Array]:
        """F (n, d) and its derivative in the bend (n, d, 3 d), of signals (n, m), bend (n, 3 d) and theta (k,)."""
        value, slopes = self._mapped(self._motion, signals, bend, theta)
        return value, self._columns(slopes)

    def by_parameters(self, signals: Array, bend: Array, theta: Array) -> Array:
        """The derivative of F in theta, (n, d, k)."""
        (slopes,) = self._mapped(self._parameters, signals, bend, theta)
        return self._columns(slopes)

    def mean_change(self, signals: Array, theta: Array) -> Array:
        """The derivative in theta of the samples' mean of dF/dbend where nothing is bent, (d, 3 d, k)."""
        n, straight = len(signals), np.zeros((self.bend.numel(), len(signals)))
        total = self._mixed.map(n, [False, False, True], [True])(signals.T, straight, theta).full()
        return np.asarray(total / n, dtype=np.float64).reshape((self.size, self.bend.numel(), len(theta)), order="F")

    @cached_property
    def _mixed(self) -> Any:
        import casadi as ca

        slopes = ca.vec(ca.jacobian(self.graph, self.bend))
        mixed = ca.densify(ca.jacobian(slopes, self.theta))
        return ca.Function("mixed", [self.u, self.bend, self.theta], [mixed])

    @cached_property
    def _motion(self) -> Any:
        import casadi as ca

        slopes = ca.vec(ca.jacobian(self.graph, self.bend))
        return ca.Function("motion", [self.u, self.bend, self.theta], [ca.densify(self.graph), ca.densify(slopes)])

    @cached_property
    def _parameters(self) -> Any:
        import casadi as ca

        slopes = ca.vec(ca.jacobian(self.graph, self.theta))
        return ca.Function("parameters", [self.u, self.bend, self.theta], [ca.densify(slopes)])

    def _columns(self, slopes: Array) -> Array:
        return slopes.reshape(len(slopes), -1, self.size).transpose(0, 2, 1)

    @staticmethod
    def _mapped(function: Any, signals: Array, bend: Array, theta: Array) -> list[Array]:
        n = len(signals)
        found = function.map(n).call([signals.T, bend.T, np.tile(theta[:, None], (1, n))])
        return [np.asarray(part.full().T, dtype=np.float64) for part in found]
