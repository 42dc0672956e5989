"""Sensitivities of load or bias to selected parameters over a grid of the others."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation.partial_evaluation import partially_evaluated
from modeling.evaluation.tape import NO_OPERAND, Tape
from modeling.evaluation.tape_evaluation import TapeEvaluation
from modeling.evaluation.vector_function import Signals, VectorFunction

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative (p, a) of a vector function in a parameters, at their nominal values.

    Operations on the signals alone are evaluated once for all values of the other parameters.
    """

    function: VectorFunction
    tape: Tape
    which: tuple[int, ...]

    @classmethod
    def of(cls, function: VectorFunction, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
        """Of a vector function in the parameters `which`, at these nominal values."""
        return _derived(function, which, nominal)

    @cached_property
    def _used(self) -> set[int]:
        return {number for _, *operands in self.tape.operations for number in operands} | set(self.tape.results)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it depends on."""
        return tuple(name for number, name in enumerate(self.function.inputs) if number in self._used)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it depends on."""
        first = self.tape.inputs
        return tuple(name for number, name in enumerate(self.function.names, first) if number in self._used)

    @cached_property
    def expression(self) -> Hashable:
        """A key, equal for sensitivities that are the same function of the same signals and parameters."""
        names: dict[int, object] = dict(enumerate((*self.function.inputs, *self.function.names, *self.tape.constants)))
        names[NO_OPERAND] = None

        def named(number: int) -> object:
            return names.get(number, number - self.tape.first)

        steps = tuple((name, named(a), named(b)) for name, a, b in self.tape.operations)
        return steps, tuple(map(named, self.tape.results))

    def values(self, signals: Signals, parameters: Mapping[str, Array], samples: int) -> Array:
        """(samples, p, g, a) at g values of each parameter (g,)."""
        count = max((len(parameters[name]) for name in self.parameters), default=1)
        theta = np.zeros((count, self.function.count))
        for name in self.parameters:
            theta[:, self.function.names.index(name)] = parameters[name]
        p, active = self.function.rows, self.function.active
        found = np.zeros((samples, p, count, len(self.which)), order="F")
        active_columns = [column for column, i in enumerate(self.which) if i in active]
        outputs = [found[:, row, :, column] for column in active_columns for row in range(p)]
        self._evaluation.run(self.function.columns(signals, samples), theta, outputs)
        return found

    @cached_property
    def _evaluation(self) -> TapeEvaluation:
        return TapeEvaluation(self.tape)


@lru_cache(maxsize=256)
def _derived(function: VectorFunction, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
    tape = function.derivative(tuple(i for i in which if i in function.active))
    return Sensitivity(function, partially_evaluated(tape, dict(zip(which, nominal, strict=True))), which)
