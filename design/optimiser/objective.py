"""Objective: the criterion of an experiment as a function of a trajectory's coefficients, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.criteria.criterion import Criterion
from design.information.experiment import Experiment
from design.trajectories.trajectory import Trajectory, TrajectorySeries

Array = NDArray[np.float64]
DERIVATIVE_ORDERS = (0, 1, 2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Objective:
    """criterion(M(z)) of the trajectories of a series, sampled at `samples` instants.

    The states x_t = B_t z are linear in the coefficients z (k,), and M = sum_t m(x_t) as long as all effects are
    static. So with w = d criterion / d m and C its second derivative

        gradient = sum_t B_t' m'(x_t)' w,      Hessian = sum_t B_t' [w m''(x_t)] B_t + J' C J,   J = sum_t m'(x_t) B_t,

    m running over the entries of the upper triangle that the criterion depends on. Each part is a CasADi function of
    one state, mapped over the samples. With dynamic effects, coloured noise or time there is a gradient only.
    """

    experiment: Experiment
    criterion: Criterion
    series: TrajectorySeries
    samples: int

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: they are soon compiled again.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def value(self, coefficients: Array) -> float:
        """The criterion (larger is better) at z (k,) over all readings; minus infinity if one is unidentifiable."""
        return self.criterion.value(self.experiment.information(Trajectory(self.series, coefficients), self.samples))

    def thinned(self, samples: int) -> Self:
        """The same with another number of samples: differs by degree ln(samples / before) and quadrature error."""
        return replace(self, samples=samples)

    @property
    def exact(self) -> bool:
        """Whether there is an exact Hessian."""
        return not (self.experiment.has_memory or self.experiment.timed)

    @cached_property
    def states(self) -> Array:
        """B (N, 3n, k): position, velocity and acceleration of all joints at every sample by coefficient."""
        instants = self.series.instants(self.samples)
        return np.concatenate([self.series.basis(instants, order) for order in DERIVATIVE_ORDERS], axis=1)

    # ------------------------------------------------------------------------ parts of one state, CasADi SX

    @cached_property
    def _entries(self) -> list[tuple[int, int]]:
        """Rows and columns of the entries of M that the criterion depends on, in its upper triangle."""
        size = self.experiment.size
        matrix = ca.MX.sym("M", size, size)
        score = ca.Function("score", [matrix], [self.criterion.graph(matrix)])
        used = {divmod(int(entry), size) for entry in score.jac_sparsity(0, 0).get_triplet()[1]}
        return sorted((i, j) for j, i in used if i <= j)

    @cached_property
    def sample(self) -> tuple[Any, Any, Any]:
        """Functions of one state x (3n,): m, and (m, dm/dx); and of x and weights w: the second derivative of w' m."""
        experiment = self.experiment
        x = ca.SX.sym("x", 3 * experiment.joints)
        columns = ca.reshape(experiment.sample()(x), len(experiment.channels), experiment.size)
        entries = ca.vertcat(*[ca.dot(columns[:, i], columns[:, j]) for i, j in self._entries])
        weight = ca.SX.sym("w", len(self._entries))
        slopes = ca.jacobian(entries, x)
        curvature = ca.hessian(ca.dot(weight, entries), x)[0]
        return (
            ca.Function("entries", [x], [ca.cse(ca.densify(entries))]),
            ca.Function("slopes", [x], [ca.cse(ca.densify(slopes))]),
            ca.Function("curvature", [x, weight], [ca.cse(ca.densify(curvature))]),
        )

    @cached_property
    def score(self) -> tuple[Any, Any, Any]:
        """Functions of the entries of M / N: the criterion of M, its gradient and its Hessian."""
        size = self.experiment.size
        entries, matrix = ca.SX.sym("m", len(self._entries)), ca.SX.zeros(size, size)
        for value, (i, j) in zip(ca.vertsplit(entries), self._entries, strict=True):
            matrix[i, j] = matrix[j, i] = self.samples * value
        score = self.criterion.expression(matrix)
        hessian, gradient = ca.hessian(score, entries)
        return (
            ca.Function("score", [entries], [score]),
            ca.Function("gradient", [entries], [ca.densify(gradient)]),
            ca.Function("hessian", [entries], [ca.densify(hessian)]),
        )

    # ------------------------------------------------------------------------------- the whole, CasADi MX

    def graph(self, z: Any) -> Any:
        """The criterion as a CasADi MX expression of the coefficients z (k,)."""
        if self.exact:
            return self.score[0](self._mean(z))
        series = self.series
        information = self.experiment.graph(self._states_of(z), series.duration, periodic=series.periodic)
        return self.criterion.graph(information)

    def hessian(self, z: Any) -> Any:
        """The exact second derivative (k, k) of `graph`; only where `exact`."""
        count, states = self.samples, self._states_of(z)
        _, slopes, curvature = self.sample
        mean = self._mean(z)
        weight, score_hessian = (function(mean) for function in self.score[1:])
        jacobian = slopes.map(count)(states) @ self._basis / count
        blocks = curvature.map(count)(states, ca.repmat(weight / count, 1, count))
        state_hessian = ca.diagcat(*ca.horzsplit(blocks, 3 * self.experiment.joints))
        return self._basis.T @ state_hessian @ self._basis + jacobian.T @ score_hessian @ jacobian

    def _mean(self, z: Any) -> Any:
        """The entries of M / N."""
        return ca.sum2(self.sample[0].map(self.samples)(self._states_of(z))) / self.samples

    @cached_property
    def _basis(self) -> Any:
        return ca.sparsify(ca.DM(self.states.reshape(-1, self.series.size)))

    def _states_of(self, z: Any) -> Any:
        return ca.reshape(self._basis @ z, 3 * self.experiment.joints, self.samples)


@dataclass(frozen=True, eq=False)
class SampledFunction:
    """A CasADi function with one dense result (r, c), at `samples` columns of its arguments, in and out of arrays.

    CasADi writes into memory that NumPy owns: its own matrices would be turned into arrays number by number.
    """

    function: Any
    samples: int

    def __call__(self, *arguments: Array) -> Array:
        """The results (r, c, samples) at the columns of each argument (.., samples)."""
        buffer, evaluate = self._mapped.buffer()
        taken = [np.ravel(np.asarray(argument, dtype=np.float64), order="F") for argument in arguments]
        results = np.empty(self._mapped.nnz_out(0))
        for number, numbers in enumerate(taken):
            buffer.set_arg(number, numbers.data)
        buffer.set_res(0, results.data)
        evaluate()
        return results.reshape(*self.function.size_out(0), self.samples, order="F")

    @cached_property
    def _mapped(self) -> Any:
        return self.function.map(self.samples)


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
        weight, score_hessian = (function(mean)[:, :, 0] for function in self._score[1:])
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
        return [(moving, np.ascontiguousarray(states[:, j::n][:, :, moving])) for j, moving in enumerate(columns)]

    def _states(self, z: Array) -> Array:
        """(3n, N): the order of the samples' functions, position of all joints first."""
        states = np.empty((len(DERIVATIVE_ORDERS), self.objective.series.joints, self.objective.samples))
        for j, (moving, basis) in enumerate(self._blocks):
            states[:, j] = (basis @ z[moving]).T
        return states.reshape(-1, self.objective.samples)

    def _mean(self, states: Array) -> Array:
        """The entries of M / N, (E, 1)."""
        return np.asarray(self._entries(states).mean(axis=-1))

    def _jacobian(self, slopes: Array) -> Array:
        """J (E, k) = sum_t m'(x_t) B_t from m' (E, 3n, N)."""
        n = self.objective.series.joints
        jacobian = np.zeros((len(slopes), self.objective.series.size))
        for j, (moving, basis) in enumerate(self._blocks):
            of_joint = slopes[:, j::n].transpose(0, 2, 1).reshape(len(slopes), -1)
            jacobian[:, moving] += of_joint @ basis.reshape(-1, len(moving))
        return jacobian

    def _state_hessian(self, curvature: Array) -> Array:
        """sum_t B_t' W_t B_t (k, k) from W (N, 3n, 3n)."""
        n, size = self.objective.series.joints, self.objective.series.size
        total = np.zeros((size, size))
        for j, (rows, basis) in enumerate(self._blocks):
            for i, (columns, other_basis) in enumerate(self._blocks[: j + 1]):
                product = (curvature[:, j::n, i::n] @ other_basis).reshape(-1, len(columns))
                block = basis.reshape(-1, len(rows)).T @ product
                total[self._crossings[j, i]] += block
                if i < j:
                    total[self._crossings[i, j]] += block.T
        return total

    @cached_property
    def _crossings(self) -> dict[tuple[int, int], tuple[NDArray[np.intp], ...]]:
        """The indices of each joint's coefficients by those of another."""
        numbered = list(enumerate(moving for moving, _ in self._blocks))
        return {(j, i): np.ix_(rows, columns) for j, rows in numbered for i, columns in numbered}

    @cached_property
    def _score(self) -> list[SampledFunction]:
        return [SampledFunction(function, 1) for function in self.objective.score]

    @cached_property
    def _entries(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[0], self.objective.samples)

    @cached_property
    def _slopes(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[1], self.objective.samples)

    @cached_property
    def _curvature(self) -> SampledFunction:
        return SampledFunction(self.objective.sample[2], self.objective.samples)
