"""Numerical gradient and Hessian of the design objective."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from design.optimiser.objective import DERIVATIVE_ORDERS, Objective
from design.optimiser.sampled_function import SampledFunction

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ObjectiveDerivatives:
    """Value, gradient and Hessian of an exact objective, by the parts of `Objective` and dense matrix products.

    The same formulas as its CasADi graph, ten times faster for series with many coefficients: each joint depends only
    on its own columns of B, whose blocks are dense.
    """

    objective: Objective

    def value(self, z: Array) -> float:
        """The criterion at z (k,); not a number or minus infinity where M is singular."""
        return float(self._score[0](self._mean(self._states(z))).item())

    def second_order(self, z: Array) -> tuple[Array, Array]:
        """Gradient (k,) and Hessian (k, k) at z (k,)."""
        objective, states = self.objective, self._states(z)
        count = objective.samples
        mean = self._mean(states)
        weight, score_hessian = (part(mean)[:, :, 0] for part in self._score[1:])
        jacobian = self._jacobian(self._slopes(states) / count)
        curvature = self._curvature(states, np.repeat(weight / count, count, axis=1))
        curved = self._state_hessian(curvature.transpose(2, 0, 1))
        return jacobian.T @ weight[:, 0], curved + jacobian.T @ score_hessian @ jacobian

    # --------------------------------------------------------------------------------------------- parts

    @cached_property
    def _blocks(self) -> list[tuple[NDArray[np.intp], Array]]:
        """For each joint the coefficients (c,) that move it, and its position, velocity, acceleration (N, 3, c)."""
        states, n = self.objective.states, self.objective.series.joints
        columns = [np.flatnonzero(self.objective.series.mixing[j].any(axis=0)) for j in range(n)]
        return [(own, np.ascontiguousarray(states[:, j::n][:, :, own])) for j, own in enumerate(columns)]

    def _states(self, z: Array) -> Array:
        """(3n, N): the order of the samples' functions, position of all joints first."""
        states = np.empty((len(DERIVATIVE_ORDERS), self.objective.series.joints, self.objective.samples))
        for j, (own, basis) in enumerate(self._blocks):
            states[:, j] = (basis @ z[own]).T
        return states.reshape(-1, self.objective.samples)

    def _mean(self, states: Array) -> Array:
        """The entries of M / N, (E, 1)."""
        return np.asarray(self._entries(states).mean(axis=-1))

    def _jacobian(self, slopes: Array) -> Array:
        """J (E, k) = sum_t m'(x_t) B_t from m' (E, 3n, N)."""
        n = self.objective.series.joints
        jacobian = np.zeros((len(slopes), self.objective.series.size))
        for j, (own, basis) in enumerate(self._blocks):
            of_joint = slopes[:, j::n].transpose(0, 2, 1).reshape(len(slopes), -1)
            jacobian[:, own] += of_joint @ basis.reshape(-1, len(own))
        return jacobian

    def _state_hessian(self, curvature: Array) -> Array:
        """sum_t B_t' W_t B_t (k, k) from W (N, 3n, 3n)."""
        n, size = self.objective.series.joints, self.objective.series.size
        total = np.zeros((size, size))
        for j, (rows, basis) in enumerate(self._blocks):
            for i, (columns, other_basis) in enumerate(self._blocks[: j + 1]):
                product = (curvature[:, j::n, i::n] @ other_basis).reshape(-1, len(columns))
                part = basis.reshape(-1, len(rows)).T @ product
                total[self._crossings[j, i]] += part
                if i < j:
                    total[self._crossings[i, j]] += part.T
        return total

    @cached_property
    def _crossings(self) -> dict[tuple[int, int], tuple[NDArray[np.intp], ...]]:
        """The indices of each joint's coefficients by those of another."""
        numbered = list(enumerate(own for own, _ in self._blocks))
        return {(j, i): np.ix_(rows, columns) for j, rows in numbered for i, columns in numbered}

    @cached_property
    def _score(self) -> list[SampledFunction]:
        return [SampledFunction(part, 1) for part in self.objective.score]

    @cached_property
    def _entries(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[0], self.objective.samples)

    @cached_property
    def _slopes(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[1], self.objective.samples)

    @cached_property
    def _curvature(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[2], self.objective.samples)
