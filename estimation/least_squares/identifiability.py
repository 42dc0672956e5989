"""Unidentifiable parameter combinations (null space in reduced echelon form) and the least certain direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from estimation.least_squares.linear_least_squares import UNIDENTIFIABLE_SHARE, ScaledSVD
from modeling.parameter import Parameter

Array = NDArray[np.float64]

MIN_NAMED_SHARE = 0.3
"""Share of the largest component below which a component of the least certain direction is not printed."""


@dataclass(frozen=True, eq=False)
class ParameterDirection:
    """A change of several parameters at once: `amounts` (g,) in their units, the first one positive."""

    parameters: tuple[Parameter, ...]
    amounts: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that change."""
        return tuple(p.name for p in self.parameters)

    def __str__(self) -> str:
        changes = [
            f"{'raising' if a > 0 else 'lowering'} {p.name} by {_quantity(abs(a), p.unit)}"
            for p, a in zip(self.parameters, self.amounts, strict=True)
        ]
        return _listed(changes)


@dataclass(frozen=True, eq=False)
class UnidentifiableDirection(ParameterDirection):
    """A change that leaves every row unchanged, by 1 unit of the first parameter; to first order if nonlinear."""

    def __str__(self) -> str:
        if len(self.parameters) == 1:
            return f"{self.names[0]} is not identifiable from this motion"
        return (
            f"{_listed(self.names)} are collinear on this motion: {super().__str__()} leaves the prediction unchanged"
        )


@dataclass(frozen=True, eq=False)
class LeastCertainDirection(ParameterDirection):
    """The identifiable direction of largest variance: a change by one standard deviation, its largest components."""

    def __str__(self) -> str:
        return f"least certain: {super().__str__()} is one standard deviation"


def unidentifiable_directions(
    scaled_svd: ScaledSVD, parameters: Sequence[Parameter]
) -> tuple[UnidentifiableDirection, ...]:
    """A sparse basis of the null space of the rows: directions with few parameters each.

    Of an orthonormal basis N (k, d), d rows are pivots, largest first (QR with pivoting of N'), and N N[pivots]^-1 is
    the reduced echelon form. A parameter without any sensitivity thus stands alone, and each direction has exactly one
    pivot parameter.
    """
    null_space = scaled_svd.unseen
    count = null_space.shape[1]
    if not count:
        return ()
    order = qr(null_space.T, mode="r", pivoting=True)[1]
    pivots = np.sort(order[:count])
    echelon = null_space @ np.linalg.inv(null_space[pivots])
    return tuple(_unidentifiable_direction(column, scaled_svd.scale, parameters) for column in echelon.T)


def least_certain_direction(scaled_svd: ScaledSVD, parameters: Sequence[Parameter]) -> LeastCertainDirection | None:
    """Right singular vector (unit columns) of the smallest identifiable singular value; None when there is none."""
    if not scaled_svd.seen.any():
        return None
    last = int(np.flatnonzero(scaled_svd.seen)[-1])
    direction = scaled_svd.right[last]
    kept = np.abs(direction) >= MIN_NAMED_SHARE * np.abs(direction).max()
    amounts = direction[kept] / scaled_svd.singular[last] / scaled_svd.scale[kept]
    named = tuple(p for p, k in zip(parameters, kept, strict=True) if k)
    return LeastCertainDirection(named, amounts * np.sign(amounts[0]))


def _unidentifiable_direction(
    direction: Array, scale: Array, parameters: Sequence[Parameter]
) -> UnidentifiableDirection:
    kept = np.abs(direction) >= UNIDENTIFIABLE_SHARE * np.linalg.norm(direction)
    amounts = direction[kept] / scale[kept]
    return UnidentifiableDirection(tuple(p for p, k in zip(parameters, kept, strict=True) if k), amounts / amounts[0])


def _quantity(amount: float, unit: str) -> str:
    return f"{amount:.3g}" + (f" {unit}" if unit != "1" else "")


def _listed(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
