"""Regressor of a model that is linear in its parameters: Y = Phi theta.

Equations 22.7 to 22.9 of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from dataclasses import dataclass

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.space import Space


def regressor(model: WrenchModel) -> sp.Matrix:
    """Phi (channels, parameters), the derivative of the static prediction with respect to the parameters.

    Raises InputError when the model is not linear in its parameters, or has memory.
    """
    model.require_direct("regressor")
    symbols = [p.symbol for p in model.parameters]
    prediction = (model.load + model.bias).applyfunc(sp.expand)
    phi = prediction.jacobian(symbols)
    if model.transfer_function != 1 or phi.free_symbols & set(symbols):
        raise InputError(
            what="the model is not linear in its parameters",
            where=" + ".join(["rigid tip", *(e.id for e in model.effects)]),
            remedy="use the regressor of the base model",
        )
    return phi


@dataclass(frozen=True)
class RegressorFunctions:
    """The four functions of the motion in the planar regressor (22.9).

    With (ax, ay) the acceleration of the sensor origin: M1 multiplies m in fx and mlg in tau, M2 = ddphi,
    M3 multiplies m in fy, M4 = dphi².
    """

    M1: sp.Expr
    M2: sp.Expr
    M3: sp.Expr
    M4: sp.Expr


def regressor_functions(model: WrenchModel) -> RegressorFunctions:
    """M1..M4, elements of the derived planar regressor.

    Raises InputError for a model that is not planar.
    """
    if model.space is not Space.PLANE:
        raise InputError(what="M1..M4 are defined for the planar model", where="model", remedy="use planar()")
    phi = regressor(model.base)
    return RegressorFunctions(M1=phi[0, 3], M2=phi[0, 4], M3=phi[1, 3], M4=phi[1, 4])
