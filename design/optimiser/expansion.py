"""Expansion: the criterion of a motion with its gradient and its Hessian, in numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.optimiser.objective import ORDERS, Objective

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Expansion:
    """An exact objective about any coefficients, by the pieces of `Objective` and dense products of matrices.

    The same formulas as its CasADi graph, ten times faster for series with many coefficients: each joint depends on its
    own columns of B alone, and what is left are products of full matrices.
    """

    objective: Objective

    def value(self, z: Array) -> float:
        """The criterion at z (k,); not a number or minus infinity where M is singular."""
        states = self._states(z)
        entries = np.array(self._entries(states)).sum(axis=1) / self.objective.samples
        return float(self.objective.score(entries)[0])

    def second_order(self, z: Array) -> tuple[Array, Array]:
        """Gradient (k,) and Hessian (k, k) at z (k,)."""
        objective, states = self.objective, self._states(z)
        count = objective.samples
        entries = np.array(self._entries(states)).sum(axis=1) / count
        _, weight, bend = (np.array(part) for part in objective.score(entries))
        slopes = np.array(self._slopes(states)).reshape(len(entries), len(states), count, order="F") / count
        curvature = np.array(self._curvature(states, np.repeat(weight / count, count, axis=1)))
        through = self._through(slopes)
        own = self._own(curvature.reshape(len(states), len(states), count, order="F").transpose(2, 0, 1))
        return through.T @ weight[:, 0], own + through.T @ bend @ through

    # -------------------------------------------------------------------------------------------- pieces

    @cached_property
    def _blocks(self) -> list[tuple[NDArray[np.intp], Array]]:
        """For each joint the coefficients (c,) that move it, and its position, velocity, acceleration (N, 3, c)."""
        states, n = self.objective.states, self.objective.series.joints
        columns = [np.flatnonzero(self.objective.series.mixing[j].any(axis=0)) for j in range(n)]
        return [(own, np.ascontiguousarray(states[:, j::n][:, :, own])) for j, own in enumerate(columns)]

    def _states(self, z: Array) -> Array:
        """(3n, N): the order of the samples' functions, position of all joints first."""
        states = np.empty((len(ORDERS), self.objective.series.joints, self.objective.samples))
        for j, (own, basis) in enumerate(self._blocks):
            states[:, j] = (basis @ z[own]).T
        return states.reshape(-1, self.objective.samples)

    def _through(self, slopes: Array) -> Array:
        """J (E, k) = sum_t m'(x_t) B_t from m' (E, 3n, N)."""
        n = self.objective.series.joints
        through = np.zeros((len(slopes), self.objective.series.size))
        for j, (own, basis) in enumerate(self._blocks):
            mine = slopes[:, j::n].transpose(0, 2, 1).reshape(len(slopes), -1)
            through[:, own] += mine @ basis.reshape(-1, len(own))
        return through

    def _own(self, curvature: Array) -> Array:
        """sum_t B_t' W_t B_t (k, k) from W (N, 3n, 3n)."""
        n, size = self.objective.series.joints, self.objective.series.size
        total = np.zeros((size, size))
        for j, (mine, basis) in enumerate(self._blocks):
            for i, (other, across) in enumerate(self._blocks[: j + 1]):
                product = (curvature[:, j::n, i::n] @ across).reshape(-1, len(other))
                part = basis.reshape(-1, len(mine)).T @ product
                total[np.ix_(mine, other)] += part
                if i < j:
                    total[np.ix_(other, mine)] += part.T
        return total

    @cached_property
    def _entries(self) -> Any:
        return self.objective.sample[0].map(self.objective.samples)

    @cached_property
    def _slopes(self) -> Any:
        return self.objective.sample[1].map(self.objective.samples)

    @cached_property
    def _curvature(self) -> Any:
        return self.objective.sample[2].map(self.objective.samples)
