"""Equilibrium: the equation that the bend obeys at each sample, compiled, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation import Evaluation

if TYPE_CHECKING:
    from modeling.emitted import Emitted

Array = NDArray[np.float64]


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
        value, slopes = np.zeros((len(bend), self.size)), np.zeros((len(bend), self.size, bend.shape[1]))
        which = [i for i in self.column.active if i >= self.parameters]
        outputs = [value[:, row, None] for row in range(self.size)]
        outputs += [slopes[:, row, i - self.parameters, None] for i in which for row in range(self.size)]
        self._run(self._motion, signals, bend, theta, outputs)
        return value, slopes

    def value(self, signals: Array, bend: Array, theta: Array) -> Array:
        """F (n, d) alone."""
        value = np.zeros((len(bend), self.size))
        self._run(self._balance, signals, bend, theta, [value[:, row, None] for row in range(self.size)])
        return value

    def by_parameters(self, signals: Array, bend: Array, theta: Array) -> Array:
        """The derivative of F in theta, (n, d, k)."""
        slopes = np.zeros((len(bend), self.size, self.parameters))
        which = [i for i in self.column.active if i < self.parameters]
        outputs = [slopes[:, row, i, None] for i in which for row in range(self.size)]
        self._run(self._moved, signals, bend, theta, outputs)
        return slopes

    def mean_change(self, signals: Array, theta: Array) -> Array:
        """The derivative in theta of the samples' mean of dF/dbend where nothing is bent, (d, 3 d, k)."""
        n, straight = len(signals), np.zeros((3 * self.size, len(signals)))
        total = self._mixed.map(n, [False, False, True], [True])(signals.T, straight, theta).full()
        return np.asarray(total / n, dtype=np.float64).reshape((self.size, 3 * self.size, len(theta)), order="F")

    @staticmethod
    def _run(evaluation: Evaluation, signals: Array, bend: Array, theta: Array, outputs: list[Array]) -> None:
        changing = [*np.ascontiguousarray(signals.T), *np.ascontiguousarray(bend.T)]
        evaluation.run(changing, np.asarray(theta, dtype=float)[None], outputs)

    @cached_property
    def _motion(self) -> Evaluation:
        """F, then its derivative in the bend, column after column."""
        return self._evaluation([i for i in self.column.active if i >= self.parameters], valued=True)

    @cached_property
    def _balance(self) -> Evaluation:
        """F alone."""
        return self._evaluation([], valued=True)

    @cached_property
    def _moved(self) -> Evaluation:
        """The derivative of F in theta, column after column."""
        return self._evaluation([i for i in self.column.active if i < self.parameters], valued=False)

    def _evaluation(self, which: list[int], *, valued: bool) -> Evaluation:
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
