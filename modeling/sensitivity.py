"""Sensitivity: derivatives of a load or zero in some parameters, for many values of the others at once."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation import Evaluation
from modeling.folding import folded
from modeling.prediction import Emitted, Signals
from modeling.tape import NONE, Tape

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative (p, a) of an expression in a parameters, which stand at their nominal values.

    What depends on the motion alone is computed once for all values of the other parameters.
    """

    emitted: Emitted
    tape: Tape
    which: tuple[int, ...]

    @classmethod
    def of(cls, emitted: Emitted, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
        """Of an expression in the parameters `which`."""
        return _derived(emitted, which, nominal)

    @cached_property
    def _used(self) -> set[int]:
        return {number for _, *operands in self.tape.operations for number in operands} | set(self.tape.results)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it depends on."""
        return tuple(name for number, name in enumerate(self.emitted.inputs) if number in self._used)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it depends on."""
        first = self.tape.inputs
        return tuple(name for number, name in enumerate(self.emitted.names, first) if number in self._used)

    @cached_property
    def expression(self) -> Hashable:
        """What is equal for sensitivities that are the same function of the same signals and parameters."""
        names: dict[int, object] = dict(enumerate((*self.emitted.inputs, *self.emitted.names, *self.tape.constants)))
        names[NONE] = None

        def named(number: int) -> object:
            return names.get(number, number - self.tape.first)

        steps = tuple((name, named(a), named(b)) for name, a, b in self.tape.operations)
        return steps, tuple(map(named, self.tape.results))

    def values(self, signals: Signals, parameters: Mapping[str, Array], samples: int) -> Array:
        """(samples, p, g, a) at g values of each parameter (g,)."""
        count = max((len(parameters[name]) for name in self.parameters), default=1)
        theta = np.zeros((count, self.emitted.count))
        for name in self.parameters:
            theta[:, self.emitted.names.index(name)] = parameters[name]
        p, active = self.emitted.rows, self.emitted.active
        found = np.zeros((samples, p, count, len(self.which)), order="F")
        moved = [column for column, i in enumerate(self.which) if i in active]
        outputs = [found[:, row, :, column] for column in moved for row in range(p)]
        self._evaluation.run(self.emitted.columns(signals, samples), theta, outputs)
        return found

    @cached_property
    def _evaluation(self) -> Evaluation:
        return Evaluation(self.tape)


@lru_cache(maxsize=256)
def _derived(emitted: Emitted, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity:
    tape = emitted.derivative(tuple(i for i in which if i in emitted.active))
    return Sensitivity(emitted, folded(tape, dict(zip(which, nominal, strict=True))), which)
