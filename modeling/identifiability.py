"""Identifiability: null space of sensitivities by scaled SVD, its parameter combinations, the least certain direction.

Sensitivities are those of recordings (estimation) or of trajectories that an arm can follow (design).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from modeling.parameter import Parameter

Array = NDArray[np.float64]

SINGULAR_VALUE_TOLERANCE = 1e-9
"""Relative singular value, of columns of unit norm, below which a direction is only rounding: of smoothed signals it is
1e-12 at the most, along random trajectories 1e-14, and identifiable directions have at least 1e-5."""
UNIDENTIFIABLE_SHARE = 1e-3
"""Component in the null space, of columns of unit norm, from which on a parameter is unidentifiable."""
MIN_NAMED_SHARE = 0.3
"""Share of the largest component below which a component of the least certain direction is not printed."""
MOST_LISTED = 6
"""Parameters of an unidentifiable direction that text names with their amounts: of more, such as a whole calibration
matrix and its tool, a reader needs how many and whose."""


@dataclass(frozen=True, eq=False)
class ScaledSVD:
    """SVD of the rows of k parameters, columns scaled to unit norm, with its numerical rank.

    scale      (k,) norms of the columns, 1 for a column of zeros
    singular   (k,) descending
    left       (k, k) and `right` (k, k): root / scale = left diag(singular) right
    rounding   share of the largest singular value at which a direction is only rounding
    """

    scale: Array
    singular: Array
    left: Array
    right: Array
    rounding: float

    @classmethod
    def of(cls, root: Array, rounding: float = SINGULAR_VALUE_TOLERANCE, faint: float = 0.0) -> Self:
        """Of the R factor (k, k) of the rows, whose columns have the same norms and angles.

        Columns of norm up to `faint` count as zero: scaling them to unit norm would amplify rounding.
        """
        lengths = np.linalg.norm(root, axis=0)
        scale = np.where(lengths > faint, lengths, 1.0)
        left, singular, right = np.linalg.svd(np.where(lengths > faint, root, 0.0) / scale)
        return cls(scale, singular, left, right, rounding)

    @cached_property
    def regular(self) -> NDArray[np.bool_]:
        """Identifiable directions: which rows of `right` have a singular value above rounding."""
        return np.asarray(self.singular > self.rounding * max(float(self.singular.max(initial=0.0)), 1e-300))

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the identifiable directions; 1 when the columns are orthogonal."""
        kept = self.singular[self.regular]
        return float(kept[0] / kept[-1]) if len(kept) else 1.0

    @property
    def null_space(self) -> Array:
        """Orthonormal basis (k, d) of the null space of the columns of unit norm."""
        return np.asarray(self.right[~self.regular].T)

    @cached_property
    def identifiable(self) -> NDArray[np.bool_]:
        """Identifiable parameters (k,): those without a component in the null space."""
        return np.asarray(np.linalg.norm(self.null_space, axis=1) < UNIDENTIFIABLE_SHARE)

    @cached_property
    def inverse(self) -> Array:
        """Pseudo-inverse (k, k) of R: R^-1 on the identifiable directions, zero on the null space."""
        kept = self.regular
        return np.asarray((self.right[kept].T / self.singular[kept]) @ self.left[:, kept].T / self.scale[:, None])

    @cached_property
    def covariance(self) -> Array:
        """(R'R)^-1 (k, k) on the identifiable directions; the null space gets no variance."""
        return np.asarray(self.inverse @ self.inverse.T)


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
    """A change that leaves the prediction of a `motion` unchanged, by 1 unit of the first parameter.

    To first order where a model is nonlinear in its parameters.
    """

    motion: str = "this motion"

    def __str__(self) -> str:
        if len(self.parameters) == 1:
            return f"{self.names[0]} is not identifiable from {self.motion}"
        return open_combinations([self]) if len(self.parameters) > MOST_LISTED else self.whole

    @property
    def whole(self) -> str:
        """The same with all its parameters, however many."""
        if len(self.parameters) == 1:
            return str(self)
        collinear = f"{_listed(self.names)} are collinear on {self.motion}"
        return f"{collinear}: {super().__str__()} leaves the prediction unchanged"


def open_combinations(directions: Sequence[UnidentifiableDirection]) -> str:
    """One sentence on directions of many parameters: how many, and of how many parameters of what."""
    owners: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for direction in directions for name in direction.names):
        label, at, place = name.partition("@")
        effect, dot, _ = label.partition(".")
        tool = f"the tool {place}" if at else "the tool"
        owner = effect if dot else f"the zero{' of ' + place if at else ''}" if label.startswith("bias_") else tool
        owners.setdefault(owner, []).append(name)
    whose = [
        f"{', '.join(names)} of {owner}" if len(names) <= 2 else f"{names[0]} to {names[-1]} ({len(names)} of {owner})"
        for owner, names in owners.items()
    ]
    count = "1 combination" if len(directions) == 1 else f"{len(directions)} combinations"
    of = f"{sum(map(len, owners.values()))} parameters"
    be = "is" if len(directions) == 1 else "are"
    return f"{count} of {of} {be} not identifiable from {directions[0].motion}: {_listed(whose)}"


@dataclass(frozen=True, eq=False)
class LeastCertainDirection(ParameterDirection):
    """The identifiable direction of largest variance: a change by one standard deviation, its largest components."""

    def __str__(self) -> str:
        return f"least certain: {super().__str__()} is one standard deviation"


def unidentifiable_directions(
    scaled_svd: ScaledSVD, parameters: Sequence[Parameter], motion: str = "this motion"
) -> tuple[UnidentifiableDirection, ...]:
    """A sparse basis of the null space of the rows: directions with few parameters each.

    Of an orthonormal basis N (k, d), d rows are pivots, largest first (QR with pivoting of N'), and N N[pivots]^-1 is
    the reduced echelon form. A parameter without any sensitivity thus stands alone, and each direction has exactly one
    pivot parameter.
    """
    null_space = scaled_svd.null_space
    count = null_space.shape[1]
    if not count:
        return ()
    order = scipy.linalg.qr(null_space.T, mode="r", pivoting=True)[1]
    pivots = np.sort(order[:count])
    echelon = null_space @ np.linalg.inv(null_space[pivots])
    return tuple(_unidentifiable_direction(column, scaled_svd.scale, parameters, motion) for column in echelon.T)


def least_certain_direction(scaled_svd: ScaledSVD, parameters: Sequence[Parameter]) -> LeastCertainDirection | None:
    """Right singular vector (unit columns) of the smallest identifiable singular value; None when there is none."""
    if not scaled_svd.regular.any():
        return None
    last = int(np.flatnonzero(scaled_svd.regular)[-1])
    direction = scaled_svd.right[last]
    kept = np.abs(direction) >= MIN_NAMED_SHARE * np.abs(direction).max()
    amounts = direction[kept] / scaled_svd.singular[last] / scaled_svd.scale[kept]
    named = tuple(p for p, k in zip(parameters, kept, strict=True) if k)
    return LeastCertainDirection(named, amounts * np.sign(amounts[0]))


def _unidentifiable_direction(
    direction: Array, scale: Array, parameters: Sequence[Parameter], motion: str
) -> UnidentifiableDirection:
    kept = np.abs(direction) >= UNIDENTIFIABLE_SHARE * np.linalg.norm(direction)
    amounts = direction[kept] / scale[kept]
    named = tuple(p for p, k in zip(parameters, kept, strict=True) if k)
    return UnidentifiableDirection(named, amounts / amounts[0], motion)


def _quantity(amount: float, unit: str) -> str:
    return f"{amount:.3g}" + (f" {unit}" if unit != "1" else "")


def _listed(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]
