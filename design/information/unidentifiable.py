"""Unidentifiable parameter combinations: kernel of the sensitivities over all trajectories of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from design.information.experiment import Experiment
from design.information.random_sensitivities import random_sensitivities
from modeling.parameter import Parameter
from modeling.rig.rig import Limits

Array = NDArray[np.float64]

KERNEL_TOLERANCE = 1e-9
"""Share of a sensitivity's norm below which it is rounding (1e-14 is usual, and along random trajectories identifiable
ones have at least 1e-5)."""


@dataclass(frozen=True, eq=False)
class UnidentifiableCombination:
    """A joint change of parameters that changes no reading: `amounts` (g,), the first one 1, in their units.

    To first order where a model is nonlinear in its parameters.
    """

    parameters: tuple[Parameter, ...]
    amounts: Array

    def __str__(self) -> str:
        names = [p.name for p in self.parameters]
        if len(names) == 1:
            return f"{names[0]} is unidentifiable along every trajectory of this arm"
        changes = [
            f"{'raising' if a > 0 else 'lowering'} {p.name} by {abs(a):.3g}" + (f" {p.unit}" if p.unit != "1" else "")
            for p, a in zip(self.parameters, self.amounts, strict=True)
        ]
        collinear = f"{_listed(names)} are collinear along every trajectory of this arm"
        return f"{collinear}: {_listed(changes)} changes no reading"


def unidentifiable_combinations(
    experiment: Experiment, limits: Limits | None = None, *, seed: int = 0
) -> tuple[UnidentifiableCombination, ...]:
    """A sparse basis of the kernel of the sensitivities over all trajectories of the arm.

    Where the sensitivities are analytic in the trajectory, random trajectories have the largest rank of all (almost
    surely). With N (k, d) orthonormal directions of the kernel and d of its rows, largest first
    (QR of N' with pivoting), N N[rows]^-1 is the identity in those rows: the reduced echelon form.
    """
    columns = random_sensitivities(experiment, limits, seed)
    norm = np.linalg.norm(columns, axis=0)
    scale = np.where(norm > 0, norm, 1.0)
    _, singular, right = np.linalg.svd(columns / scale, full_matrices=True)
    kernel = right[np.append(singular, np.zeros(len(right) - len(singular))) < KERNEL_TOLERANCE].T
    if not kernel.size:
        return ()
    chosen = np.sort(qr(kernel.T, mode="r", pivoting=True)[1][: kernel.shape[1]])
    echelon = kernel @ np.linalg.inv(kernel[chosen])
    return tuple(_combination(direction, scale, experiment.parameters) for direction in echelon.T)


def _combination(direction: Array, scale: Array, parameters: Sequence[Parameter]) -> UnidentifiableCombination:
    nonzero = [int(i) for i in np.flatnonzero(np.abs(direction) > np.sqrt(KERNEL_TOLERANCE) * np.abs(direction).max())]
    amounts = direction[nonzero] / scale[nonzero]
    return UnidentifiableCombination(tuple(parameters[i] for i in nonzero), amounts / amounts[0])


def _listed(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
