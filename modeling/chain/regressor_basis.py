"""A regressor factored into linearly independent functions of the motion and constant weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling.evaluation.tape import Tape
from modeling.evaluation.tape_evaluation import TapeEvaluation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegressorBasis:
    """reading_c = sum_i theta_i sum_j weights[i, c, j] f_j(signals), with theta_k = 1 for the constant term.

    The regressor Phi (p, k) is sparse, and its elements recur: the planar one (22.9, Bassi et al.) has 18 elements,
    made of f = 1, M1, M2, M3, M4. Sums over samples are taken of the d functions f; the weights are applied afterwards.

    inputs     the input signals
    functions  tape of f_1 .. f_d, linearly independent functions of the signals
    weights    (k + 1, p, d); the last row is the prediction at theta = 0
    """

    inputs: tuple[str, ...]
    functions: Tape
    weights: Array

    def evaluate(self, signals: Sequence[Array], out: Array) -> None:
        """Write f (d, n) of n samples, from the inputs (n,) each, in order."""
        self._evaluation.run(signals, np.zeros((1, 0)), list(out[:, :, None]))

    @cached_property
    def _evaluation(self) -> TapeEvaluation:
        return TapeEvaluation(self.functions)

    def to_data(self) -> dict[str, Any]:
        """The basis as plain data."""
        return {
            "inputs": list(self.inputs),
            "functions": self.functions.to_data(),
            "weights": self.weights.tolist(),
        }

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_data`. Raises ValueError for inconsistent data."""
        inputs, functions = tuple(data["inputs"]), Tape.from_data(data["functions"])
        weights = np.array(data["weights"], dtype=np.float64)
        if weights.ndim != 3 or weights.shape[2] != len(functions.results) or not np.isfinite(weights).all():
            raise ValueError(f"weights {weights.shape} do not match {len(functions.results)} functions")
        if functions.inputs != len(inputs) or functions.parameters:
            raise ValueError(f"functions of {functions.inputs} signals do not match {len(inputs)} inputs")
        return cls(inputs, functions, weights)
