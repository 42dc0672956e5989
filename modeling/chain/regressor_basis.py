"""A regressor factored into linearly independent functions of the motion and constant weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation.array_program import ArrayProgram

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegressorBasis:
    """reading_c = sum_i theta_i sum_j weights[i, c, j] f_j(signals), with theta_k = 1 for the constant term.

    The regressor Phi (p, k) is sparse, and its elements recur: the planar one (22.9, Bassi et al.) has 18 elements,
    made of f = 1, M1, M2, M3, M4. Sums over samples are taken of the d functions f; the weights are applied afterwards.

    functions  program for f_1 .. f_d, linearly independent functions of the signals
    weights    (k + 1, p, d); the last row is the prediction at theta = 0
    """

    functions: ArrayProgram
    weights: Array

    @property
    def inputs(self) -> tuple[str, ...]:
        """The input signals of the functions."""
        return self.functions.inputs

    def to_data(self) -> dict[str, Any]:
        """The basis as plain data."""
        return {"functions": self.functions.to_data(), "weights": self.weights.tolist()}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_data`. Raises ValueError for inconsistent data."""
        functions, weights = ArrayProgram.from_data(data["functions"]), np.array(data["weights"], dtype=np.float64)
        if weights.ndim != 3 or weights.shape[2] != len(functions.results) or not np.isfinite(weights).all():
            raise ValueError(f"weights {weights.shape} do not match {len(functions.results)} functions")
        return cls(functions, weights)
