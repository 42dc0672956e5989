"""Whether a body can have a fit's inertial parameters: the pseudo-inertia's smallest eigenvalue, with its std."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.number_format import format_number
from modeling.significance import LEVELS

Array = NDArray[np.float64]


def impossible_body(model: WrenchModel, names: Sequence[str], theta: Array, covariance: Array) -> str:
    """A sentence where no distribution of positive mass has the estimates, significantly or within their std.

    Empty where one has them, or they are not known.

    The pseudo-inertia of a body is positive definite (P. M. Wensing, S. Kim and J.-J. E. Slotine, IEEE Robotics and
    Automation Letters 3, 2018). It is affine in the parameters; its smallest eigenvalue
    has a std to first order.
    """
    inertia = pseudo_inertia(model.base)
    place = [names.index(name) for name in inertia.names]
    own = covariance[np.ix_(place, place)]
    if not np.isfinite(own).all():
        return ""
    values, vectors = np.linalg.eigh(inertia.at(theta[place]))
    if values[0] >= 0:
        return ""
    gradient = np.einsum("i,kij,j->k", vectors[:, 0], inertia.slopes, vectors[:, 0])
    std = float(np.sqrt(gradient @ own @ gradient))
    smallest = f"{format_number(values[0], 2)} ± {format_number(std, 2)}"
    if values[0] > -NormalDist().inv_cdf(1 - LEVELS.constraint) * std:
        return (
            "the motion does not determine the inertia well enough for that of a body: the smallest eigenvalue of the"
            f" pseudo-inertia is {smallest}; --physical, Constraints(physical=True), keeps it positive"
        )
    return (
        f"no body has these inertial parameters: their pseudo-inertia has the eigenvalue {smallest}, which must be"
        " positive: something is missing in the model; --physical, Constraints(physical=True), keeps it positive"
    )
