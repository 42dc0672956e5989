"""Equilibrium: the equation that the bend obeys at each sample, compiled, with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation import Evaluation
from modeling.operators.balance import Balance, Balancing

if TYPE_CHECKING:
    from modeling.emitted import Emitted

Array = NDArray[np.float64]

UNLIKE_REAL = frozenset({"fabs", "sign", "atan2"})
"""Operations that are something else, or nothing, of complex numbers."""

TINY = 1e-30
"""Imaginary step: its square is lost beside 1, its product with a derivative is not."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """F (d,) of signals (m,), parameters theta (k,), and angles, rates and accelerations of the bend (3 d,).

    column  F with theta and the bend, in this order, as its parameters; `parameters` is k
    """

    column: Emitted
    parameters: int

    @property
    def size(self) -> int:
        """The number d of angles."""
        return self.column.rows

    def at(self, signals: Array, bend: Array, theta: Array) -> tuple[Array, Array]:
        """F (n, d) and its derivative in the bend (n, d, 3 d), of signals (n, m), bend (n, 3 d) and theta (k,)."""
        value, slopes = _series(len(bend), self.size), _series(len(bend), self.size, bend.shape[1])
        outputs = [value[:, row, None] for row in range(self.size)]
        outputs += [slopes[:, row, i - self.parameters, None] for i in self._bends for row in range(self.size)]
        self._run(self._motion, signals, bend, theta, outputs)
        return value, slopes

    def over(self, signals: Array, theta: Array) -> Balance:
        """F alone, at signals (n, m) and theta (k,), as a function of the bend."""
        return self._balancing.at(np.ascontiguousarray(signals.T), theta)

    def by_parameters(self, signals: Array, bend: Array, theta: Array) -> Array:
        """The derivative of F in theta, (n, d, k)."""
        slopes = _series(len(bend), self.size, self.parameters)
        outputs = [slopes[:, row, i, None] for i in self._parameters for row in range(self.size)]
        self._run(self._moved, signals, bend, theta, outputs)
        return slopes

    def mean_change(self, signals: Array, theta: Array) -> Array:
        """The derivative in theta of the samples' mean of dF/dbend where nothing is bent, (d, 3 d, k).

        dF/dbend(theta + i h) = dF/dbend + i h d²F/dbend dtheta + O(h²), without a difference that loses digits (Squire
        and Trapp, SIAM Review 40, 1998).
        """
        if UNLIKE_REAL & {name for name, _, _ in self._stiffening.tape.operations}:
            return self._mean_change_by_graph(signals, theta)
        n, sets = len(signals), np.tile(theta.astype(complex), (len(self._parameters), 1))
        sets[range(len(self._parameters)), self._parameters] += TINY * 1j
        found = np.zeros((len(self._bends), self.size, n, len(sets)), dtype=complex)
        changing = [*np.ascontiguousarray(signals.T, dtype=complex), *np.zeros((3 * self.size, n), dtype=complex)]
        self._stiffening.run(changing, sets, list(found.reshape(-1, n, len(sets))))
        mean = np.zeros((self.size, 3 * self.size, self.parameters))
        places = np.ix_(range(self.size), [i - self.parameters for i in self._bends], self._parameters)
        mean[places] = found.imag.mean(axis=2).transpose(1, 0, 2) / TINY
        return mean

    def _mean_change_by_graph(self, signals: Array, theta: Array) -> Array:
        n, straight = len(signals), np.zeros((3 * self.size, len(signals)))
        total = self._mixed.map(n, [False, False, True], [True])(signals.T, straight, theta).full()
        return np.asarray(total / n, dtype=np.float64).reshape((self.size, 3 * self.size, len(theta)), order="F")

    @staticmethod
    def _run(evaluation: Evaluation, signals: Array, bend: Array, theta: Array, outputs: list[Array]) -> None:
        changing = [*np.ascontiguousarray(signals.T), *np.ascontiguousarray(bend.T)]
        evaluation.run(changing, np.asarray(theta, dtype=float)[None], outputs)

    @property
    def _bends(self) -> list[int]:
        """Which parameters of the column that it depends on are the bend's."""
        return [i for i in self.column.active if i >= self.parameters]

    @property
    def _parameters(self) -> list[int]:
        """Which of theta it depends on."""
        return [i for i in self.column.active if i < self.parameters]

    @cached_property
    def _motion(self) -> Evaluation:
        """F, then its derivative in the bend, column after column."""
        return self._evaluation(self._bends, valued=True)

    @cached_property
    def _stiffening(self) -> Evaluation:
        """The derivative of F in the bend, column after column, of complex numbers."""
        return Evaluation(self._evaluation(self._bends, valued=False).tape, dtype=complex)

    @cached_property
    def _moved(self) -> Evaluation:
        """The derivative of F in theta, column after column."""
        return self._evaluation(self._parameters, valued=False)

    @cached_property
    def _balancing(self) -> Balancing:
        """F alone."""
        return Balancing.of(self.column.compiled.tape.only(range(self.size)), 3 * self.size)

    def _evaluation(self, which: Sequence[int], *, valued: bool) -> Evaluation:
        compiled = self.column.compiled
        blocks = [0] * valued + [compiled.active.index(i) + 1 for i in which]
        tape = compiled.tape.only([block * self.size + row for block in blocks for row in range(self.size)])
        return Evaluation(tape.with_inputs(range(self.parameters, self.column.count)))

    @cached_property
    def _mixed(self) -> Any:
        import casadi as ca

        u, both = self.column.symbols
        theta, bend = both[: self.parameters], both[self.parameters :]
        slopes = ca.vec(ca.jacobian(self.column.graph, bend))
        mixed = ca.densify(ca.jacobian(slopes, theta))
        return ca.Function("mixed", [u, bend, theta], [mixed])


def _series(samples: int, *shape: int) -> Array:
    """Zeros (samples, ...), the samples of each entry side by side in memory."""
    return np.moveaxis(np.zeros((*shape, samples)), -1, 0)
