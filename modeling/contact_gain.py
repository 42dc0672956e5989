"""Contact gain: what the sensor makes of a contact wrench, by the same chain that it reads the tool through."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.contact import applied, components
from modeling.emission import numpy_function
from modeling.errors import InputError
from modeling.model import WrenchModel

Array = NDArray[np.float64]


@lru_cache(maxsize=64)
def contact_gain(model: WrenchModel) -> sp.Matrix:
    """What one unit of each contact component adds to the reading before memory and zero, (p, p), symbolic.

    The sensor carries the tool's motion less what the environment does (22.1): reading = G (wrench - contact), so that
    the matrix is -G, in terms of the parameters of mounting and gain. For 22.8 it is diag(-1, 1, -1). Where the gain
    depends on the load it is that of small loads. Raises InputError when it depends on a signal.
    """
    symbols = [sp.Symbol(name, real=True) for name in components(model.space)]
    force, torque = applied(model.space, symbols)
    gain = sp.Matrix(model.chain.reading(-force, -torque).jacobian(symbols))
    if changing := model.inputs_of(gain):
        raise InputError(
            what=f"what the sensor makes of a contact changes with '{changing[0]}', and one gain is not enough",
            where="contact",
            remedy="leave out the effect by which the gain follows a signal",
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


def lateness(model: WrenchModel, theta: Array) -> float:
    """By how much (s) the sensor shows slow changes late: -dH/ds at s = 0, the group delay of its memory there."""
    from modeling.chain import laplace

    if model.memory == 1:
        return 0.0
    slope = -sp.diff(model.memory, laplace()).subs(laplace(), 0)
    symbols = [p.symbol for p in model.parameters]
    return float(numpy_function(symbols, [slope])(*theta)[0])
