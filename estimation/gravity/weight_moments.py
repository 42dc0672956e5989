"""Moments of forces and motion, from which the tool's weight is fitted for any direction of gravity in base axes.

A rigid tool's force turns with the sensor: f = B R' (a - g d) + b with R the orientation and a the acceleration in base
axes, g d gravity, B free (mass, mounting, signs) and b the zero. For given d it is linear in B and b; all that its fit
needs are the second moments of f, R' a and the columns of R', so that any number of directions costs one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.gravity.rotation_terms import without_terms
from modeling.kinematics.base_mounting import Direction

Array = NDArray[np.float64]

GRID = 240
"""Directions from which the best is refined, 13 degrees apart on the sphere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeFit:
    """The fit f = B R' (a - g d) + b: B (d, d) in kg, and the rms of its residual, N."""

    matrix: Array
    rms: float

    @property
    def mass(self) -> float:
        """|det B|^(1/d), kg."""
        return float(abs(np.linalg.det(self.matrix)) ** (1 / len(self.matrix)))


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightMoments:
    """Second moments (k, k) of [R' a, columns of R', f] about their means; several recordings weigh alike.

    gravity  m/s²; axes  d, 2 or 3; recordings  how many were added
    """

    gram: Array
    axes: int
    gravity: float
    recordings: int = 1

    @classmethod
    def of(
        cls, to_sensor: Array, acceleration: Array, force: Array, gravity: float, rotation: Array | None = None
    ) -> Self:
        """Of R' (n, d, d), accelerations in base axes (n, d), m/s², and forces (n, d), N.

        `rotation` (n, k) are terms of the forces in the turning of the tool about its sensor, which are fitted to all
        else first: what follows is of what they leave.
        """
        axes = force.shape[1]
        moved = np.einsum("nij,nj->ni", to_sensor, acceleration)
        rows = np.hstack([moved, *np.moveaxis(to_sensor, 2, 0), force])
        rows = rows - rows.mean(axis=0) if rotation is None else without_terms(rows, rotation)
        return cls(gram=rows.T @ rows / len(rows), axes=axes, gravity=gravity)

    def __add__(self, other: WeightMoments) -> WeightMoments:
        """The moments of both: each recording has a zero of its own."""
        return WeightMoments(
            gram=self.gram + other.gram,
            axes=self.axes,
            gravity=self.gravity,
            recordings=self.recordings + other.recordings,
        )

    @cached_property
    def force(self) -> float:
        """Std of the forces about their mean, N."""
        return float(np.sqrt(np.trace(self.gram[-self.axes :, -self.axes :]) / (self.axes * self.recordings)))

    def fit(self, direction: Direction | Array) -> FreeFit:
        """The fit with gravity along a unit vector in base axes."""
        normal, mixed = self._normal_equations(np.asarray(direction, dtype=np.float64))
        solution = np.linalg.lstsq(normal, mixed, rcond=1e-10)[0]
        residual = self.force**2 - float(np.sum(solution * mixed)) / (self.axes * self.recordings)
        return FreeFit(matrix=np.asarray(solution.T, dtype=np.float64), rms=float(np.sqrt(max(residual, 0.0))))

    def flatness(self, direction: Direction | Array) -> float:
        """Smallest singular value, in g, of R' (a - g d): gravity takes all directions in the sensor where it is 1."""
        normal, _ = self._normal_equations(np.asarray(direction, dtype=np.float64))
        return float(np.sqrt(max(np.linalg.eigvalsh(normal / self.recordings)[0], 0.0)) / self.gravity)

    def _normal_equations(self, direction: Array) -> tuple[Array, Array]:
        eye = np.eye(self.axes)
        regressor = np.vstack([eye, *(-self.gravity * component * eye for component in direction)])
        inputs = self.gram[: -self.axes, : -self.axes]
        return regressor.T @ inputs @ regressor, regressor.T @ self.gram[: -self.axes, -self.axes :]

    @cached_property
    def best_direction(self) -> Array:
        """Unit vector (d,) of the smallest residual: the best of a grid, refined in its tangent plane."""
        from scipy.optimize import minimize  # slow to import

        directions = _grid(self.axes)
        start = directions[int(np.argmin(self._squares(directions)))]
        tangent = np.linalg.svd(start[None])[2][1:]

        def at(coordinates: Array) -> Array:
            moved = start + coordinates @ tangent
            return np.asarray(moved / np.linalg.norm(moved))

        def share(coordinates: Array) -> float:
            return (self.fit(at(coordinates)).rms / max(self.force, 1e-300)) ** 2

        found = minimize(share, np.zeros(self.axes - 1))
        return at(found.x)

    def rival(self, direction: Array, angle: float) -> Array:
        """The best direction (d,) of those further than `angle` (rad) from this one and its opposite."""
        directions = _grid(self.axes)
        others = directions[np.abs(directions @ direction) < np.cos(angle)]
        return np.asarray(others[int(np.argmin(self._squares(others)))])

    def _squares(self, directions: Array) -> Array:
        """Sums of squares (m,) of the residuals with gravity along unit vectors (m, d), up to what all share."""
        eye = np.eye(self.axes)
        regressors = np.stack([np.vstack([eye, *(-self.gravity * part * eye for part in d)]) for d in directions])
        turned, inputs = regressors.transpose(0, 2, 1), self.gram[: -self.axes, : -self.axes]
        mixed = turned @ self.gram[: -self.axes, -self.axes :]
        solutions = np.linalg.pinv(turned @ inputs @ regressors, rcond=1e-10, hermitian=True) @ mixed
        return np.asarray(-(solutions * mixed).sum(axis=(1, 2)))


def _grid(axes: int) -> Array:
    """Unit vectors: every 5 degrees of the circle, or a Fibonacci lattice of the sphere."""
    if axes == 2:
        angles = np.arange(0, 360, 5) * np.pi / 180
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    number = np.arange(GRID)
    z, turn = 1 - (2 * number + 1) / GRID, np.pi * (3 - np.sqrt(5)) * number
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
