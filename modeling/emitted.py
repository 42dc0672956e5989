"""Emitted: one column of a model as a function of arrays, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.column import Column
from modeling.compiled_column import CompiledColumn
from modeling.errors import InputError
from modeling.evaluation import Evaluation
from modeling.steps import Definitions
from modeling.tape import Tape

Array = NDArray[np.float64]
Signals = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Emitted:
    """A column (p,) as a function of signals and parameters (k,).

    inputs    names of the signals
    names     of the k parameters
    active    which parameters it depends on
    symbolic  gives what SymPy has of it, `compile` the tape: neither is asked before it is needed
    """

    inputs: tuple[str, ...]
    names: tuple[str, ...]
    active: tuple[int, ...]
    symbolic: Callable[[], Column]
    compile: Callable[[], CompiledColumn]

    @classmethod
    def of(
        cls,
        expression: sp.Matrix,
        inputs: tuple[str, ...],
        parameters: tuple[sp.Symbol, ...],
        definitions: Definitions = (),
    ) -> Self:
        """Of a symbolic column; `definitions` are the steps, in order, that say what symbols of it are."""
        column = Column(expression, inputs, parameters, definitions)
        return cls(inputs, column.names, column.active, lambda: column, lambda: CompiledColumn.of(column))

    @property
    def count(self) -> int:
        """The number k of parameters."""
        return len(self.names)

    @property
    def expression(self) -> sp.Matrix:
        """The column as SymPy has it."""
        return self.symbolic().expression

    @property
    def parameters(self) -> tuple[sp.Symbol, ...]:
        """The parameters' symbols."""
        return self.symbolic().parameters

    @property
    def definitions(self) -> Definitions:
        """The steps that say what symbols of the expression are."""
        return self.symbolic().definitions

    @cached_property
    def compiled(self) -> CompiledColumn:
        """The column and its derivatives on one tape."""
        return self.compile()

    @property
    def rows(self) -> int:
        """The number p."""
        return self.compiled.rows

    @cached_property
    def symbols(self) -> tuple[Any, Any]:
        """CasADi symbols of the inputs and of the parameters."""
        import casadi as ca

        return ca.SX.sym("u", len(self.inputs)), ca.SX.sym("theta", self.count)

    @cached_property
    def graph(self) -> Any:
        """The column (p,) as a CasADi graph over `symbols`."""
        return self.compiled.tape.only(range(self.rows)).graph(*self.symbols)

    def columns(self, signals: Signals, samples: int) -> list[Array]:
        """The inputs of the first samples, (samples,) each."""
        for name in self.inputs:
            if name not in signals:
                raise InputError(
                    what=f"the model needs the signal '{name}'",
                    where="recording",
                    remedy="record it, or leave the effect out",
                )
        return [np.asarray(signals[name], dtype=float)[:samples] for name in self.inputs]

    def samples(self, signals: Signals, samples: int) -> Array:
        """The inputs of the first samples, (samples, m)."""
        columns = self.columns(signals, samples)
        return np.stack(columns, axis=1) if columns else np.zeros((samples, 0))

    def value(self, signals: Signals, theta: Array, samples: int) -> Array:
        """Value (samples, p), at the parameters (k,) or at others for each sample (samples, k)."""
        value = np.zeros((samples, self.rows), order="F")
        self._evaluate((), signals, theta, samples, [value[:, row, None] for row in range(self.rows)])
        return value

    def tangent(self, signals: Signals, theta: Array, samples: int) -> tuple[Array, Array]:
        """Value (samples, p) and derivative (samples, p, k) in all k parameters; theta as for `value`."""
        value, derivative = (
            np.zeros((samples, self.rows), order="F"),
            np.zeros((samples, self.rows, self.count), order="F"),
        )
        outputs = [value[:, row, None] for row in range(self.rows)]
        outputs += [derivative[:, row, i, None] for i in self.active for row in range(self.rows)]
        self._evaluate(self.active, signals, theta, samples, outputs)
        return value, derivative

    def tangent_in(
        self, signals: Signals, theta: Array, which: tuple[int, ...], samples: int, *, valued: bool = True
    ) -> tuple[Array, Array]:
        """Value (samples, p), zero unless `valued`, and derivative (samples, p, len(which)) in some parameters."""
        value, derivative = (
            np.zeros((samples, self.rows), order="F"),
            np.zeros((samples, self.rows, len(which)), order="F"),
        )
        active = tuple(i for i in which if i in self.active)
        outputs = [value[:, row, None] for row in range(self.rows)] if valued else []
        outputs += [derivative[:, row, which.index(i), None] for i in active for row in range(self.rows)]
        self._evaluate(active, signals, theta, samples, outputs, valued=valued)
        return value, derivative

    def depending_on(self, signals: frozenset[str]) -> tuple[int, ...]:
        """The active parameters in which the derivative depends on one of these signals."""
        return _depending(self, signals)

    def slopes(self, signals: Signals, theta: Array, which: tuple[int, ...], samples: int) -> Array:
        """Derivative (samples, p, g, len(which)) in some parameters only, at each of g parameter sets theta (g, k)."""
        theta = np.asarray(theta, dtype=float)
        if theta.ndim != 2 or theta.shape[1] != self.count:
            raise ValueError(f"sets of {self.count} parameters were expected, not an array {theta.shape}")
        derivative = np.zeros((samples, self.rows, len(theta), len(which)), order="F")
        places = [(place, i) for place, i in enumerate(which) if i in self.active]
        outputs = [derivative[:, row, :, place] for place, _ in places for row in range(self.rows)]
        evaluation = _evaluation(self, tuple(i for _, i in places), False, False)
        evaluation.run(self.columns(signals, samples), theta, outputs)
        return derivative

    def derivative(self, which: tuple[int, ...]) -> Tape:
        """The tape of the derivative in some of the active parameters, column after column."""
        begins = [(self.active.index(i) + 1) * self.rows for i in which]
        return self.compiled.tape.only([begin + row for begin in begins for row in range(self.rows)])

    def _evaluate(
        self,
        which: tuple[int, ...],
        signals: Signals,
        theta: Array,
        samples: int,
        outputs: list[Array],
        *,
        valued: bool = True,
    ) -> None:
        """Put the value, then its derivative in the parameters `which`, into the outputs (samples, 1)."""
        theta = np.asarray(theta, dtype=float)
        if theta.shape not in ((self.count,), (samples, self.count)):
            raise ValueError(f"{self.count} parameters were expected, not an array {theta.shape}")
        varying = theta.ndim == 2
        evaluation = _evaluation(self, which, valued, varying)
        sets = np.ascontiguousarray(theta.T) if varying else theta[None]
        evaluation.run(self.columns(signals, samples), sets, outputs)


@lru_cache(maxsize=512)
def _depending(emitted: Emitted, signals: frozenset[str]) -> tuple[int, ...]:
    compiled = emitted.compiled
    moved = compiled.tape.depending_on([i for i, name in enumerate(emitted.inputs) if name in signals])
    results = compiled.tape.results
    rows = compiled.rows
    columns = {i: results[(place + 1) * rows : (place + 2) * rows] for place, i in enumerate(compiled.active)}
    return tuple(i for i, numbers in columns.items() if any(number in moved for number in numbers))


@lru_cache(maxsize=512)
def _evaluation(emitted: Emitted, which: tuple[int, ...], valued: bool, varying: bool) -> Evaluation:
    """What gives the value, when it is wanted, then the derivative in active parameters, column after column."""
    compiled = emitted.compiled
    rows, places = compiled.rows, [compiled.active.index(i) + 1 for i in which]
    wanted = [block * rows + row for block in ([0] * valued + places) for row in range(rows)]
    return Evaluation(compiled.tape.only(wanted), varying)
