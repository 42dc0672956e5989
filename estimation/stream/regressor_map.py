"""Regressor map: what a linear model predicts for a stretch of samples, laid out for filters and products."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.emission import numpy_function
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.regressor import regressor

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegressorMap:
    """Prediction Phi theta + offset of a model that is linear in its parameters, emitted to NumPy.

    `entries` are Phi' (k, p) and below it the offset, the prediction at theta = 0. Each different entry is evaluated
    once for all samples. Samples come last: a channel's series is contiguous, for filters, and so is a column of all
    channels, for products. That is some ten times quicker than sample by sample through CasADi.
    """

    entries: sp.Matrix
    inputs: tuple[str, ...]

    @cached_property
    def _different(self) -> tuple[sp.Expr, ...]:
        return tuple(dict.fromkeys(self.entries))

    @cached_property
    def _places(self) -> tuple[int, ...]:
        number = {entry: i for i, entry in enumerate(self._different)}
        return tuple(number[entry] for entry in self.entries)

    @cached_property
    def _function(self) -> Callable[..., list[Any]]:
        return numpy_function([sp.Symbol(name, real=True) for name in self.inputs], self._different)

    def __call__(self, signals: Mapping[str, Array], samples: int) -> Array:
        """Phi' of every sample, and the offset in the last place: (k + 1, p, n)."""
        values = self._function(*(signals[name] for name in self.inputs))
        rows = np.empty((len(self._places), samples))
        for row, place in zip(rows, self._places, strict=True):
            row[:] = values[place]
        return rows.reshape(*self.entries.shape, samples)


@lru_cache(maxsize=128)
def linear(model: WrenchModel) -> RegressorMap | None:
    """The map of a model without memory that is linear in its parameters, None of any other; derived once per model."""
    try:
        phi = regressor(model)
    except InputError:
        return None
    offset = (model.load + model.zero).subs({p.symbol: 0 for p in model.parameters})
    return RegressorMap(sp.Matrix.vstack(phi.T, offset.T), model.inputs)
