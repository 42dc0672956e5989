"""Scaled criteria: criteria of the covariance of parameters scaled by given magnitudes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from design.criteria.criterion import Array, Criterion
from design.criteria.symbolic_cholesky import symbolic_inverse
from modeling.errors import InputError


@dataclass(frozen=True, eq=False)
class ScaledCriterion(Criterion):
    """A criterion of C = Z^-1 M^-1 Z^-1 with Z = diag(scale): the covariance of theta_i / scale_i.

    scale (k,), positive, each in its parameter's unit: errors of that size matter equally. It makes the criterion
    independent of units, and it has to be given: A and E depend on it.
    """

    scale: Array

    def __post_init__(self) -> None:
        scale = np.array(self.scale, dtype=float)
        if scale.ndim != 1 or not (np.isfinite(scale) & (scale > 0)).all():
            raise InputError(
                what="a positive magnitude of each parameter was expected",
                where=f"scale of {self.name}",
                remedy="give for each parameter the size of error that matters equally, in its unit",
            )
        scale.flags.writeable = False
        object.__setattr__(self, "scale", scale)

    def degree(self, size: int) -> float:
        """1: the value is the logarithm of a mean that grows as M."""
        return 1.0

    def _covariance(self, information: Any) -> Any:
        """C as a CasADi expression of M."""
        size = information.shape[0]
        if size != len(self.scale):
            raise ValueError(f"{len(self.scale)} magnitudes were given for an information of {size} parameters")
        return symbolic_inverse(information * np.outer(self.scale, self.scale))
