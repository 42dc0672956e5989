"""Parameter values at which an experiment is designed, and the parameters in which it is nonlinear."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError

Array = NDArray[np.float64]
ParameterValues = Mapping[str, float]


def parameter_vector(model: WrenchModel, theta: ParameterValues | Array | None) -> Array:
    """Values of the model's parameters (k,), given by name, in order, or not at all where it is linear in them.

    Raises InputError for an unknown name, a wrong number of values, or no values where the sensitivities depend on
    them.
    """
    names = [p.name for p in model.parameters]
    if theta is None and nonlinear_parameters(model):
        raise InputError(
            what="its information depends on the values of its parameters",
            where=" + ".join(["rigid tool", *(e.id for e in model.effects)]),
            remedy="give their values, expected or from a fit (a model file)",
        )
    if theta is None or isinstance(theta, Mapping):
        given = dict(theta or {})
        unknown = sorted(set(given) - set(names))
        if unknown:
            raise InputError(what=f"the model has no parameter {unknown[0]}", where="theta", remedy=f"use {names}")
        return np.array([given.get(p.name, p.nominal) for p in model.parameters], dtype=float)
    values = np.asarray(theta, dtype=float)
    if values.shape != (len(names),):
        what = f"{len(names)} values were expected, and an array of shape {values.shape} came"
        raise InputError(what=what, where="theta", remedy="give one value for each parameter of the model")
    return values


def nonlinear_parameters(model: WrenchModel) -> tuple[int, ...]:
    """Indices of the parameters that the sensitivities depend on; none of a model that is linear in them.

    With d reading = H d load + dH load, those are the ones that d load or d zero depend on, and with dynamics those of
    H and of the load.
    """
    import casadi as ca

    prediction = compiled_prediction(model)
    found = set(prediction.transfer_parameters)
    for part in (prediction.load, prediction.bias):
        parameters = part.symbols[1]
        slopes = ca.vec(ca.jacobian(part.graph, parameters))
        found |= {i for i, depends in enumerate(ca.which_depends(slopes, parameters, 1, False)) if depends}
    return tuple(sorted(found | (set(prediction.load.active) if prediction.has_transfer_function else set())))
