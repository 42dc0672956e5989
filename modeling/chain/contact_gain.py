"""Gain matrix from contact wrench to reading, and group delay of the sensor at zero frequency."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.model import WrenchModel
from modeling.compiled.symbolic_vector import numpy_function
from modeling.errors import InputError
from modeling.rigid_body import contact_components, contact_force_torque

Array = NDArray[np.float64]


@lru_cache(maxsize=64)
def contact_gain(model: WrenchModel) -> sp.Matrix:
    """Symbolic derivative (p, p) of the reading, before transfer function and bias, in the contact components.

    The sensor exerts the tool's inertial wrench minus the environment's (22.1, Bassi et al.): reading = G (wrench -
    contact), so that the matrix is -G, in terms of the parameters of mounting and gain. For 22.8 it is diag(-1, 1, -1).
    A gain that depends on the load is linearised at zero load. Raises InputError when it depends on a signal.
    """
    symbols = [sp.Symbol(name, real=True) for name in contact_components(model.space)]
    force, torque = contact_force_torque(model.space, symbols)
    gain = sp.Matrix(model.chain.reading(-force, -torque).jacobian(symbols)).xreplace(dict.fromkeys(symbols, sp.S.Zero))
    if changing := model.inputs_of(gain):
        raise InputError(
            what=f"the gain from contact wrench to reading depends on '{changing[0]}', and a constant one is needed",
            where="contact",
            remedy="leave out the effect by which the gain depends on a signal",
        )
    return gain


def contact_gain_at(model: WrenchModel, theta: Array) -> tuple[Array, Array]:
    """The contact gain (p, p) at the parameters theta (k,), and its derivative (p, p, k) in each of them."""
    gain = contact_gain(model)
    symbols = [p.symbol for p in model.parameters]
    used = [i for i, symbol in enumerate(symbols) if symbol in gain.free_symbols]
    expressions = [*gain, *(entry for i in used for entry in gain.diff(symbols[i]))]
    values = numpy_function([symbols[i] for i in used], expressions)(*(theta[i] for i in used))
    size = len(model.channels)
    matrices = np.array(values, dtype=float).reshape(-1, size, size)
    slopes = np.zeros((size, size, len(symbols)))
    for place, i in enumerate(used):
        slopes[:, :, i] = matrices[1 + place]
    return matrices[0], slopes


def group_delay(model: WrenchModel, theta: Array) -> float:
    """Group delay (s) of the transfer function at zero frequency: -dH/ds at s = 0."""
    from modeling.compiled.straight_line_program import laplace

    if model.transfer_function == 1:
        return 0.0
    slope = -sp.diff(model.transfer_function, laplace()).subs(laplace(), 0)
    symbols = [p.symbol for p in model.parameters]
    return float(numpy_function(symbols, [slope])(*theta)[0])
