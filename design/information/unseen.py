"""Unseen: combinations of parameters that no motion of an arm shows, in words of the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from design.information.experiment import Experiment
from design.information.probe import random_columns
from modeling.parameter import Parameter
from modeling.rig import Limits

Array = NDArray[np.float64]

NOTHING = 1e-9
"""Share of a column's length below which it is rounding (1e-14 is usual, and random motions show no less than 1e-5)."""


@dataclass(frozen=True, eq=False)
class UnseenCombination:
    """A change of several parameters at once that changes no reading: `amounts` (g,), the first one 1, in their units.

    To first order where a model is not linear in its parameters.
    """

    parameters: tuple[Parameter, ...]
    amounts: Array

    def __str__(self) -> str:
        names = [p.name for p in self.parameters]
        if len(names) == 1:
            return f"{names[0]} is not seen by any motion of this arm"
        changes = [
            f"{'raising' if a > 0 else 'lowering'} {p.name} by {abs(a):.3g}" + (f" {p.unit}" if p.unit != "1" else "")
            for p, a in zip(self.parameters, self.amounts, strict=True)
        ]
        told = f"{_listed(names)} cannot be told apart by any motion of this arm"
        return f"{told}: {_listed(changes)} changes nothing"


def unseen(experiment: Experiment, limits: Limits | None = None, *, seed: int = 0) -> tuple[UnseenCombination, ...]:
    """What no motion of the arm shows: a basis of the kernel of the sensitivities, each with few parameters.

    Where the sensitivities are analytic in the motion, random motions show whatever any motion shows (almost surely),
    so that their rank is the arm's. With N (k, d) orthonormal directions of the kernel and d of its rows, largest first
    (QR of N' with pivoting), N N[rows]^-1 is the identity in those rows: the reduced echelon form.
    """
    columns = random_columns(experiment, limits, seed)
    length = np.linalg.norm(columns, axis=0)
    scale = np.where(length > 0, length, 1.0)
    _, singular, right = np.linalg.svd(columns / scale, full_matrices=True)
    kernel = right[np.append(singular, np.zeros(len(right) - len(singular))) < NOTHING].T
    if not kernel.size:
        return ()
    chosen = np.sort(qr(kernel.T, mode="r", pivoting=True)[1][: kernel.shape[1]])
    echelon = kernel @ np.linalg.inv(kernel[chosen])
    return tuple(_combination(direction, scale, experiment.parameters) for direction in echelon.T)


def _combination(direction: Array, scale: Array, parameters: Sequence[Parameter]) -> UnseenCombination:
    kept = [int(i) for i in np.flatnonzero(np.abs(direction) > np.sqrt(NOTHING) * np.abs(direction).max())]
    amounts = direction[kept] / scale[kept]
    return UnseenCombination(tuple(parameters[i] for i in kept), amounts / amounts[0])


def _listed(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
