"""Unseen: directions of the unknowns that change nothing, or least, in what was measured, in words of the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from estimation.linear.least_squares import PART, Sight
from modeling.parameter import Parameter

Array = NDArray[np.float64]

WORTH_NAMING = 0.3
"""Share of the largest part below which a part of a direction that is seen is left unsaid."""


@dataclass(frozen=True, eq=False)
class Direction:
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
class UnseenDirection(Direction):
    """A change that no row shows, by 1 of the first parameter's unit; to first order where a model is not linear."""

    def __str__(self) -> str:
        if len(self.parameters) == 1:
            return f"{self.names[0]} is not seen by this motion"
        return f"{_listed(self.names)} cannot be told apart by this motion: {super().__str__()} changes nothing"


@dataclass(frozen=True, eq=False)
class WeakestDirection(Direction):
    """The change that is seen worst: by one standard deviation, in its largest parts."""

    def __str__(self) -> str:
        return f"least certain: {super().__str__()} is one standard deviation"


def unseen_directions(sight: Sight, parameters: Sequence[Parameter]) -> tuple[UnseenDirection, ...]:
    """A basis of what the rows do not show, of directions with few parameters each.

    Of orthonormal directions N (k, d), d rows are chosen, largest first (QR with pivoting of N'), and the basis that
    is the identity in those is taken: N N[chosen]^-1, the reduced echelon form. A parameter that is not seen at all
    thus stands alone, and each other direction has at most one chosen parameter.
    """
    unseen = sight.unseen
    count = unseen.shape[1]
    if not count:
        return ()
    order = qr(unseen.T, mode="r", pivoting=True)[1]
    chosen = np.sort(order[:count])
    echelon = unseen @ np.linalg.inv(unseen[chosen])
    return tuple(_unseen(column, sight.scale, parameters) for column in echelon.T)


def weakest_direction(sight: Sight, parameters: Sequence[Parameter]) -> WeakestDirection | None:
    """The direction of columns of unit length with the smallest singular value that is seen; None when nothing is."""
    if not sight.seen.any():
        return None
    last = int(np.flatnonzero(sight.seen)[-1])
    direction = sight.right[last]
    kept = np.abs(direction) >= WORTH_NAMING * np.abs(direction).max()
    amounts = direction[kept] / sight.singular[last] / sight.scale[kept]
    named = tuple(p for p, k in zip(parameters, kept, strict=True) if k)
    return WeakestDirection(named, amounts * np.sign(amounts[0]))


def _unseen(direction: Array, scale: Array, parameters: Sequence[Parameter]) -> UnseenDirection:
    kept = np.abs(direction) >= PART * np.linalg.norm(direction)
    amounts = direction[kept] / scale[kept]
    return UnseenDirection(tuple(p for p, k in zip(parameters, kept, strict=True) if k), amounts / amounts[0])


def _quantity(amount: float, unit: str) -> str:
    return f"{amount:.3g}" + (f" {unit}" if unit != "1" else "")


def _listed(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
