"""Pull fit: the weight of a rigid tool whose mounting is unknown, with a cable that pulls the tool beside it.

A cable to a place in the cell pulls nearly one way in base axes, as gravity does: beside one, a level base looks as if
it were not, and an aligned sensor as if it were turned. The inertia of the tool and the change of the pull along the
path tell them apart. With u from the point of the tool where the cable is fastened to its anchor, the force is

    f = m Q (R' (a - g d) - s max(0, |u| - length) u / |u|) + b

in which s is the stiffness per mass; for a given cable, m and Q follow in closed form (`weight_fit.py`). It is a rival
of other readings: whether there is a cable, with its torque, is for the effect `cable_spring` to tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.evidence.weight_fit import WeightFit, weight_fit

Array = NDArray[np.float64]

ROWS = 300
"""Of a recording that are fitted: the pull of a cable changes no faster than the pose."""
ANCHOR, REACH = 5.0, 0.5
"""m, within which the anchor is sought of the base, and the point of the tool of the sensor, as `cable_spring` does."""
DISTANCES = (1.0, 3.0)
"""m, of the anchors from the middle of the path from which the fit starts, on all sides: near, and far in the cell."""
STARTS, STEPS = 3, 60
"""Of these anchors, so many that explain the most are refined, in so many steps at most."""
SHARE = 0.5
"""Of the specific force, the pull per mass at the start."""
AS_WELL = 1.02
"""Ratio of residuals up to which two explain as well: beside a level base, a direction of gravity that is none is made
good by another cable, nearly to the noise; a base that stands otherwise is made good by none in the cell."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PulledTool:
    """Rows of recordings to which the weight of a tool is fitted, with a cable or without.

    to_sensor  (n, d, d) R'
    position   (n, d) of the sensor in base axes, m
    specific   (n, d) a - g d in base axes, m/s²
    force      (n, d) N, less what `basis` spans
    basis      (n, r) orthonormal: a constant of each recording, and terms that may be part of the forces
    mounting   (d, d) where it is known
    """

    to_sensor: Array
    position: Array
    specific: Array
    force: Array
    basis: Array
    mounting: Array | None = None

    @classmethod
    def of(cls, to_sensor: Array, position: Array, specific: Array, force: Array, terms: Array | None = None) -> Self:
        """Of the rows (n, ...) of one recording, thinned; `terms` (n, k) may be part of the forces."""
        every = slice(None, None, -(-len(force) // ROWS))
        columns = np.ones((len(force), 1)) if terms is None else np.hstack([np.ones((len(force), 1)), terms])
        left, sizes, _ = np.linalg.svd(columns[every] / _norms(columns[every]), full_matrices=False)
        basis = left[:, sizes > 1e-10 * sizes[0]]
        own = force[every] - basis @ (basis.T @ force[every])
        return cls(
            to_sensor=to_sensor[every], position=position[every], specific=specific[every], force=own, basis=basis
        )

    def __add__(self, other: Self) -> Self:
        rows, columns = self.basis.shape
        basis = np.zeros((rows + len(other.basis), columns + other.basis.shape[1]))
        basis[:rows, :columns], basis[rows:, columns:] = self.basis, other.basis
        joined = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("to_sensor", "position", "specific", "force")
        }
        return replace(self, **joined, basis=basis)

    @cached_property
    def weight(self) -> WeightFit:
        """The fit without a cable."""
        return self._weight(self._along(np.zeros_like(self.position)))

    @cached_property
    def pulled(self) -> WeightFit:
        """The fit with the cable that explains the most, at the cost of its parameters.

        Its squares are larger by what stiffness, anchor, length and point cost by the Bayesian information criterion.
        """
        from scipy.optimize import least_squares  # slow to import

        axes = self.position.shape[1]
        low = np.array([0.0, *(-ANCHOR,) * axes, 0.0, *(-REACH,) * axes])
        high = np.array([np.inf, *(ANCHOR,) * axes, 2 * ANCHOR, *(REACH,) * axes])
        starts = sorted(self._starts(), key=lambda start: float(np.sum(self._residual(start) ** 2)))[:STARTS]
        found = [
            least_squares(self._residual, np.clip(start, low, high), bounds=(low, high), x_scale="jac", max_nfev=STEPS)
            for start in starts
        ]
        best = min(found, key=lambda one: float(one.cost))
        fit = self._weight(self._along(self._pull(best.x)))
        return replace(fit, squares=fit.squares * self.force.size ** (len(low) / self.force.size))

    def _starts(self) -> list[Array]:
        axes, middle = self.position.shape[1], self.position.mean(axis=0)
        size = SHARE * float(np.sqrt(np.mean(np.sum(self.specific**2, axis=1))))
        sides = np.vstack([np.eye(axes), -np.eye(axes)])
        point = np.zeros(axes)
        return [
            np.array([size / distance, *(middle + distance * side), 0.0, *point])
            for distance, side in product(DISTANCES, sides)
        ]

    def _pull(self, cable: Array) -> Array:
        """Pull per mass (n, d) in sensor axes, m/s², of a cable: s, anchor, length, point."""
        axes = self.position.shape[1]
        stiffness, anchor, length, point = cable[0], cable[1 : axes + 1], cable[axes + 1], cable[axes + 2 :]
        vector = _turned(self.to_sensor, anchor - self.position) - point
        distance = np.linalg.norm(vector, axis=1, keepdims=True)
        return np.asarray(stiffness * np.maximum(distance - length, 0.0) / np.maximum(distance, 1e-9) * vector)

    def _along(self, pull: Array) -> Array:
        """What the weight is a multiple of (n, d), less what the basis spans."""
        rows = _turned(self.to_sensor, self.specific) - pull
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def _weight(self, along: Array) -> WeightFit:
        return weight_fit(along, self.force, mounting=self.mounting)

    def _residual(self, cable: Array) -> Array:
        along = self._along(self._pull(cable))
        fit = self._weight(along)
        return np.asarray((self.force - fit.mass * along @ fit.mounting.T).ravel())


def joined(tools: Sequence[PulledTool]) -> PulledTool:
    """The rows of several recordings of one tool."""
    return reduce(PulledTool.__add__, tools)


def cable_instead(as_stated: PulledTool, changed: PulledTool) -> WeightFit | None:
    """The fit of a cable where that explains the forces as well as another reading of them, changed; else None.

    It is nearer to the truth than the change alone, and the change does not add to what a cable explains.
    """
    if not as_stated.pulled.is_nearer_than(changed.weight):
        return None
    return as_stated.pulled if as_stated.pulled.rms < AS_WELL * changed.pulled.rms else None


def _turned(turns: Array, vectors: Array) -> Array:
    """Vectors (n, d) times rotation matrices (n, d, d)."""
    return np.asarray(np.einsum("nij,nj->ni", turns, vectors))


def _norms(columns: Array) -> Array:
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
