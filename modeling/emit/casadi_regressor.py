"""CasADi regressor: the regressor of the rigid tool as a CasADi function."""

from __future__ import annotations

from typing import Any

from modeling.emit.base import BaseRegressor
from modeling.emit.graph import graphs_of
from modeling.space import signals


def casadi_regressor(base: BaseRegressor) -> Any:
    """Function `regressor` of one sample: inputs as in FORMATS by name, output `Phi` (p, k)."""
    import casadi as ca

    arguments = {name: ca.SX.sym(name, len(components)) for name, components in base.arguments.items()}
    parts = [part for argument in arguments.values() for part in ca.vertsplit(argument)]
    elements = graphs_of(base.program.shared, dict(zip(signals(*base.inputs), parts, strict=True)))
    columns = base.matrix.shape[1]
    Phi = ca.reshape(ca.vertcat(*elements), columns, -1).T
    return ca.Function("regressor", list(arguments.values()), [ca.densify(Phi)], list(arguments), ["Phi"])
