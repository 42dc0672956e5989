"""One term of the reading or its sensitivities: a matrix of signals through a transfer function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.information.sampling import FrequencyResponse
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import Prediction, VectorFunction, compiled_prediction
from modeling.chain.stages.bias_stage import Bias
from modeling.chain.stages.linear_dynamics_stage import LinearDynamics
from modeling.errors import InputError

Array = NDArray[np.float64]


class ReadingPart(Enum):
    """Which part of reading = H(s) load + zero."""

    LOAD = "load"
    BIAS = "bias"


@dataclass(frozen=True, kw_only=True)
class ModelTransferFunction:
    """H(j omega) of a model at theta, or its derivative by the parameter `slope`, an index of `transfer_parameters`."""

    model: WrenchModel
    theta: tuple[float, ...]
    slope: int | None = None

    def __call__(self, omega: Array) -> NDArray[np.complex128]:
        """At angular frequencies (L,) in rad/s: (L,)."""
        gain, slopes = compiled_prediction(self.model).transfer(omega, np.array(self.theta))
        return gain if self.slope is None else slopes[self.slope]


@dataclass(frozen=True, eq=False, kw_only=True)
class SensitivityTerm:
    """H(s) times a matrix (p, c) of signals, which is added to c columns of an experiment.

    part       of the model's reading at theta (k,)
    by         indices of the c parameters that it is differentiated by; None for the part itself, c = 1
    columns    of the experiment
    response   H(j omega) at angular frequencies in rad/s, None for 1
    factor     of the whole term
    """

    model: WrenchModel
    theta: Array
    part: ReadingPart
    by: tuple[int, ...] | None
    columns: tuple[int, ...]
    response: FrequencyResponse | None = None
    factor: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the signals (m,) that the matrix is a function of."""
        return self._vector_function.inputs

    @cached_property
    def function(self) -> Any:
        """CasADi function (SX) from the signals (m,) to the matrix (p, c), before H."""
        import casadi as ca

        inputs, parameters = self._vector_function.symbols
        value = self.factor * self._vector_function.graph
        matrix = value if self.by is None else ca.jacobian(value, parameters)[:, list(self.by)]
        general = ca.Function("term", [inputs, parameters], [ca.densify(matrix)])
        return ca.Function("term", [inputs], [general(inputs, ca.DM(self.theta))])

    def values(self, signals: Mapping[str, Array], samples: int) -> Array:
        """The matrix at every sample, (N, p, c), before H."""
        value, derivative = self._vector_function.tangent_in(
            signals, self.theta, self.by or (), samples, valued=self.by is None
        )
        return self.factor * (value[:, :, None] if self.by is None else derivative)

    @property
    def _vector_function(self) -> VectorFunction:
        prediction = compiled_prediction(self.model)
        return prediction.load if self.part is ReadingPart.LOAD else prediction.bias

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: workers of a pool compile their own.
        return {field.name: getattr(self, field.name) for field in fields(self)}


def sensitivity_terms(model: WrenchModel, theta: Array, first: int = 0) -> tuple[SensitivityTerm, ...]:
    """The terms of d reading / d theta (p, k) at theta (k,), in the columns first, first + 1, ..

    reading = H(s) load + bias, so d reading = H d load + dH load + d bias, the second for each parameter of H.
    Raises InputError for a model with another stage after its load: its sensitivities have no such terms.
    """
    prediction = compiled_prediction(model)
    _require_load_and_filter(prediction)
    parts = zip(prediction_terms(model, theta, first), (prediction.load, prediction.bias), strict=True)
    terms = [replace(t, by=part.active, columns=tuple(first + i for i in part.active)) for t, part in parts]
    for number, index in enumerate(prediction.transfer_parameters):
        slope = ModelTransferFunction(model=model, theta=tuple(theta), slope=number)
        column = (first + index,)
        terms.append(
            SensitivityTerm(model=model, theta=theta, part=ReadingPart.LOAD, by=None, columns=column, response=slope)
        )
    return tuple(term for term in terms if term.columns)


def _require_load_and_filter(prediction: Prediction) -> None:
    others = [stage.__name__ for stage in prediction.stages if stage not in (LinearDynamics, Bias)]
    if others:
        what = f"a design knows a static load, a linear filter and a bias, not the stage {', '.join(others)}"
        raise InputError(what=what, where="model", remedy="leave the effect that puts it there out")


def prediction_terms(model: WrenchModel, theta: Array, column: int, factor: float = 1.0) -> tuple[SensitivityTerm, ...]:
    """The terms of `factor` times the predicted reading at theta (k,), in one column of an experiment."""
    response = (
        ModelTransferFunction(model=model, theta=tuple(theta))
        if compiled_prediction(model).has_transfer_function
        else None
    )
    load = SensitivityTerm(
        model=model, theta=theta, part=ReadingPart.LOAD, by=None, columns=(column,), response=response, factor=factor
    )
    return load, replace(load, part=ReadingPart.BIAS, response=None)
