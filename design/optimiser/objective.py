"""Objective: the criterion of an experiment as a function of a trajectory's coefficients, with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
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

    def graph(self, z: Any) -> Any:
        """The criterion as a CasADi MX expression of the coefficients z (k,)."""
        series = self.series
        basis = ca.sparsify(ca.DM(self.states.reshape(-1, series.size)))
        states = ca.reshape(basis @ z, 3 * self.experiment.joints, self.samples)
        return self.criterion.graph(self.experiment.graph(states, series.duration, periodic=series.periodic))


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


class Expansion(ABC):
    """The criterion about one trajectory: its parts are evaluated when they are asked for, each once."""

    value: float
    """The criterion; not a number or minus infinity where M is singular."""

    @property
    @abstractmethod
    def gradient(self) -> Array:
        """Its derivative (k,) by the coefficients."""

    @property
    def hessian(self) -> Array | None:
        """Its exact second derivative (k, k); None where it would cost more than it saves."""
        return None


@dataclass(frozen=True, eq=False)
class JointStates:
    """States x_t = B_t z of an objective's samples, joint by joint: a joint depends on its own columns of B only."""

    objective: Objective

    @cached_property
    def blocks(self) -> list[tuple[NDArray[np.intp], Array]]:
        """For each joint the coefficients (c,) that move it, and its position, velocity, acceleration (N, 3, c)."""
        states, n = self.objective.states, self.objective.series.joints
        columns = [np.flatnonzero(self.objective.series.mixing[j].any(axis=0)) for j in range(n)]
        return [(moving, np.ascontiguousarray(states[:, j::n][:, :, moving])) for j, moving in enumerate(columns)]

    def along(self, z: Array) -> Array:
        """(3n, N): the order of the samples' functions, position of all joints first."""
        states = np.empty((len(DERIVATIVE_ORDERS), self.objective.series.joints, self.objective.samples))
        for j, (moving, basis) in enumerate(self.blocks):
            states[:, j] = (basis @ z[moving]).T
        return states.reshape(-1, self.objective.samples)

    def pulled_back(self, slopes: Array) -> Array:
        """sum_t slopes_t B_t (E, k) from slopes (E, 3n, N)."""
        n = self.objective.series.joints
        total = np.zeros((len(slopes), self.objective.series.size))
        for j, (moving, basis) in enumerate(self.blocks):
            of_joint = slopes[:, j::n].transpose(0, 2, 1).reshape(len(slopes), -1)
            total[:, moving] += of_joint @ basis.reshape(-1, len(moving))
        return total


@dataclass(frozen=True, eq=False)
class AdjointDerivatives:
    """Value and gradient of an objective without memory, by one adjoint sweep over the samples.

    With columns S_t (p, k) and G the criterion's gradient by M, d criterion = 2 sum_t tr((S_t G)' dS_t): reverse
    differentiation of one sample's columns with the seed 2 S_t G, whatever the number of entries of M.
    """

    objective: Objective

    def at(self, z: Array) -> Expansion:
        """About z (k,)."""
        states = self._states.along(z)
        columns = self._columns(states).reshape(self.objective.experiment.size, -1, self.objective.samples)
        rows = columns.reshape(len(columns), -1)
        return AdjointExpansion(self, states, columns, np.asarray(rows @ rows.T))

    def swept(self, states: Array, columns: Array, weight: Array) -> Array:
        """The gradient (k,) at states (3n, N), columns (k, p, N) and weights G (k, k)."""
        seeds = 2 * np.tensordot(weight, columns, axes=1).reshape(-1, self.objective.samples)
        return np.asarray(self._states.pulled_back(self._adjoint(states, seeds).transpose(1, 0, 2))[0])

    @cached_property
    def _states(self) -> JointStates:
        return JointStates(self.objective)

    @cached_property
    def _columns(self) -> SampledFunction:
        return SampledFunction(self.objective.experiment.sample(), self.objective.samples)

    @cached_property
    def _adjoint(self) -> SampledFunction:
        x = ca.SX.sym("x", 3 * self.objective.experiment.joints)
        columns = self.objective.experiment.sample()(x)
        seed = ca.SX.sym("seed", columns.numel())
        swept = ca.Function("adjoint", [x, seed], [ca.cse(ca.densify(ca.jtimes(columns, x, seed, True)))])
        return SampledFunction(swept, self.objective.samples)


@dataclass(frozen=True, eq=False)
class AdjointExpansion(Expansion):
    """By the states (3n, N), the columns (k, p, N) and the information (k, k)."""

    derivatives: AdjointDerivatives
    states: Array
    columns: Array
    information: Array

    @cached_property
    def value(self) -> float:  # type: ignore[override]
        """The criterion of the information."""
        return self.derivatives.objective.criterion.value(self.information)

    @cached_property
    def gradient(self) -> Array:
        """By an adjoint sweep."""
        weight = self.derivatives.objective.criterion.gradient(self.information)
        return self.derivatives.swept(self.states, self.columns, weight)


@dataclass(frozen=True, eq=False)
class GraphDerivatives:
    """Value and gradient of an objective with memory, by CasADi's graph of the whole trajectory."""

    objective: Objective

    def at(self, z: Array) -> Expansion:
        """About z (k,)."""
        return GraphExpansion(self, z)

    @cached_property
    def functions(self) -> tuple[Any, Any]:
        """CasADi functions of the coefficients: the criterion, and its gradient."""
        z = ca.MX.sym("z", self.objective.series.size)
        graph = self.objective.graph(z)
        return ca.Function("value", [z], [graph]), ca.Function("gradient", [z], [ca.gradient(graph, z)])


@dataclass(frozen=True, eq=False)
class GraphExpansion(Expansion):
    """About the coefficients z (k,)."""

    derivatives: GraphDerivatives
    z: Array

    @cached_property
    def value(self) -> float:  # type: ignore[override]
        """By the graph."""
        return float(self.derivatives.functions[0](self.z))

    @cached_property
    def gradient(self) -> Array:
        """By reverse differentiation of the graph."""
        return np.array(self.derivatives.functions[1](self.z)).ravel()


@dataclass(frozen=True, eq=False)
class SecondOrderDerivatives:
    """Value, gradient and Hessian of an objective without memory, by the parts of `Objective` and matrix products."""

    objective: Objective

    def at(self, z: Array) -> Expansion:
        """About z (k,)."""
        states = self._states.along(z)
        mean = np.asarray(self._entries(states).mean(axis=-1))
        return SecondOrderExpansion(self, states, mean, float(self._score[0](mean).item()))

    def second_order(self, states: Array, mean: Array) -> tuple[Array, Array]:
        """Gradient (k,) and Hessian (k, k) at states (3n, N) and entries of M / N (E, 1)."""
        count = self.objective.samples
        weight, score_hessian = (function(mean)[:, :, 0] for function in self._score[1:])
        jacobian = self._states.pulled_back(self._slopes(states) / count)
        curvature = self._curvature(states, np.repeat(weight / count, count, axis=1))
        curved = self._state_hessian(curvature.transpose(2, 0, 1))
        return jacobian.T @ weight[:, 0], curved + jacobian.T @ score_hessian @ jacobian

    # --------------------------------------------------------------------------------------------- parts

    @cached_property
    def _states(self) -> JointStates:
        return JointStates(self.objective)

    def _state_hessian(self, curvature: Array) -> Array:
        """sum_t B_t' W_t B_t (k, k) from W (N, 3n, 3n)."""
        n, size = self.objective.series.joints, self.objective.series.size
        total = np.zeros((size, size))
        for j, (rows, basis) in enumerate(self._states.blocks):
            for i, (columns, other_basis) in enumerate(self._states.blocks[: j + 1]):
                product = (curvature[:, j::n, i::n] @ other_basis).reshape(-1, len(columns))
                block = basis.reshape(-1, len(rows)).T @ product
                total[self._crossings[j, i]] += block
                if i < j:
                    total[self._crossings[i, j]] += block.T
        return total

    @cached_property
    def _crossings(self) -> dict[tuple[int, int], tuple[NDArray[np.intp], ...]]:
        """The indices of each joint's coefficients by those of another."""
        numbered = list(enumerate(moving for moving, _ in self._states.blocks))
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


@dataclass(frozen=True, eq=False)
class SecondOrderExpansion(Expansion):
    """By the states (3n, N), the entries of M / N (E, 1) and the value."""

    derivatives: SecondOrderDerivatives
    states: Array
    mean: Array
    value: float

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        return self.derivatives.second_order(self.states, self.mean)

    @property
    def gradient(self) -> Array:
        """By the entries' slopes."""
        return self._parts[0]

    @property
    def hessian(self) -> Array:
        """By the entries' slopes and curvatures."""
        return self._parts[1]


ObjectiveDerivatives = AdjointDerivatives | GraphDerivatives | SecondOrderDerivatives
"""Expansions of an objective about coefficients (`at`)."""
