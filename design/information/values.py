"""Values: the numbers of a model's parameters at which an experiment is designed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.prediction import compiled

Array = NDArray[np.float64]
Values = Mapping[str, float]


def values_of(model: WrenchModel, theta: Values | Array | None) -> Array:
    """Values of the model's parameters (k,) from those by name, in order, or none where they do not matter.

    Raises InputError for a name that is no parameter, a wrong number of values, or none where the sensitivities
    depend on them.
    """
    names = [p.name for p in model.parameters]
    if theta is None and curving(model):
        raise InputError(
            what="what it says of its parameters depends on their values",
            where=" + ".join(["rigid tool", *(e.id for e in model.effects)]),
            remedy="give their values, expected or from a fit (a model file)",
        )
    if theta is None or isinstance(theta, Mapping):
        given = dict(theta or {})
        strange = sorted(set(given) - set(names))
        if strange:
            raise InputError(what=f"the model has no parameter {strange[0]}", where="theta", remedy=f"use {names}")
        return np.array([given.get(p.name, p.nominal) for p in model.parameters], dtype=float)
    values = np.asarray(theta, dtype=float)
    if values.shape != (len(names),):
        what = f"{len(names)} values were expected, and an array of shape {values.shape} came"
        raise InputError(what=what, where="theta", remedy="give one value for each parameter of the model")
    return values


def curving(model: WrenchModel) -> tuple[int, ...]:
    """Places of the parameters that the sensitivities depend on; none of a model that is linear in them.

    With d reading = H d load + dH load, those are the ones that d load or d zero depend on, and with memory those of H
    and of the load.
    """
    import casadi as ca

    prediction = compiled(model)
    found = set(prediction.memory_parameters)
    for part in (prediction.load, prediction.zero):
        parameters = part.symbols[1]
        slopes = ca.vec(ca.jacobian(part.graph, parameters))
        found |= {i for i, matters in enumerate(ca.which_depends(slopes, parameters, 1, False)) if matters}
    return tuple(sorted(found | (set(prediction.load.active) if prediction.remembers else set())))
