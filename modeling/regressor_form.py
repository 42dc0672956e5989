"""Regressor form: a prediction that is linear in its parameters, as few functions of the motion and their weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling.array_program import ArrayProgram
from modeling.description import described
from modeling.store import stored

if TYPE_CHECKING:
    from modeling.model import WrenchModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RegressorForm:
    """reading_c = sum_i theta_i sum_j weights[i, c, j] f_j(signals), with theta_k = 1 for what no parameter scales.

    The regressor Phi (p, k) is mostly zeros, and what is not comes again: the planar one (22.9) has 18 elements, made
    of f = 1, M1, M2, M3, M4. Whatever sums over samples is a sum over the d functions f, and the weights come after it.

    functions  the program that gives f_1 .. f_d, linearly independent of each other, of the signals
    weights    (k + 1, p, d); the last row belongs to the prediction at theta = 0
    """

    functions: ArrayProgram
    weights: Array

    @property
    def inputs(self) -> tuple[str, ...]:
        """The signals that the functions take."""
        return self.functions.inputs

    def to_data(self) -> dict[str, Any]:
        """The form as lists, strings and numbers."""
        return {"functions": self.functions.to_data(), "weights": self.weights.tolist()}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """The form of what `to_data` gave. Raises ValueError for what is none."""
        functions, weights = ArrayProgram.from_data(data["functions"]), np.array(data["weights"], dtype=np.float64)
        if weights.ndim != 3 or weights.shape[2] != len(functions.results) or not np.isfinite(weights).all():
            raise ValueError(f"weights {weights.shape} of {len(functions.results)} functions")
        return cls(functions, weights)


def regressor_form(model: WrenchModel) -> RegressorForm | None:
    """The form of a model that is linear in its parameters and has no memory, None of any other.

    It is all that a fit of a linear model needs to know of the derivation, and is kept on disk by what the model is.
    """
    try:
        what = {"regressor form": described(model)}
    except TypeError:  # an effect of somebody else's module
        return _read(_derived(model))
    return stored(what, lambda: _derived(model), _read)


def _derived(model: WrenchModel) -> Mapping[str, Any]:
    from modeling.linear_derivation import derived  # SymPy is slow to import

    found = derived(model)
    return {"form": None if found is None else found.to_data()}


def _read(data: Mapping[str, Any]) -> RegressorForm | None:
    return None if data["form"] is None else RegressorForm.from_data(data["form"])
