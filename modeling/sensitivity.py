"""Sensitivity: derivatives of a load or zero in some parameters, for many values of the others at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.emission import numpy_function
from modeling.prediction import Emitted, Signals

Array = NDArray[np.float64]

UNEVALUATED = ("Derivative", "Heaviside", "sign", "Piecewise")
"""What SymPy makes of kinks that an amplitude moves: those derivatives are left to the exact sensitivities."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative (p, a) of an expression in a parameters, which stand at their nominal values.

    Evaluated on whole arrays, samples along the first axis and parameter values along the second, so that what depends
    on the motion alone is computed once for all values.
    """

    expression: sp.ImmutableMatrix
    signals: tuple[str, ...]
    parameters: tuple[str, ...]

    @classmethod
    def of(cls, emitted: Emitted, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity | None:
        """Of an expression in the parameters `which`; None where arrays cannot evaluate it."""
        return _derived(emitted, which, nominal)

    @cached_property
    def _function(self):  # type: ignore[no-untyped-def]
        inputs = [sp.Symbol(n, real=True) for n in self.signals] + [sp.Symbol(n, real=True) for n in self.parameters]
        return numpy_function(inputs, list(self.expression))

    def values(self, signals: Signals, parameters: Mapping[str, Array], samples: int) -> Array:
        """(samples, p, g, a) at g values of each parameter (g,)."""
        p, a = self.expression.shape
        motion = [np.asarray(signals[n], dtype=np.float64)[:samples, None] for n in self.signals]
        others = [np.asarray(parameters[n], dtype=np.float64)[None, :] for n in self.parameters]
        count = max((o.shape[1] for o in others), default=1)
        found = np.empty((samples, p, count, a))
        entries = self._function(*motion, *others)
        for place, entry in enumerate(entries):
            found[:, place // a, :, place % a] = entry
        return found


@lru_cache(maxsize=256)
def _derived(emitted: Emitted, which: tuple[int, ...], nominal: tuple[float, ...]) -> Sensitivity | None:
    if emitted.definitions:
        return None
    amplitudes = [emitted.parameters[i] for i in which]
    at = {symbol: sp.Float(value) if value else sp.S.Zero for symbol, value in zip(amplitudes, nominal, strict=True)}
    columns = [[row.diff(symbol).xreplace(at) for symbol in amplitudes] for row in emitted.expression]
    expression = sp.ImmutableMatrix(columns)
    if expression.has(*(getattr(sp, name) for name in UNEVALUATED)):
        return None
    free = {s.name for s in expression.free_symbols}
    parameters = tuple(s.name for s in emitted.parameters if s.name in free)
    return Sensitivity(expression, tuple(n for n in emitted.inputs if n in free), parameters)
