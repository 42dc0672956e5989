"""Moments of forces and motion, from which the tool's weight is fitted for any direction of gravity in base axes.

A rigid tool's force turns with the sensor: f = B R' (a - g d) + b with R the orientation and a the acceleration in base
axes, g d gravity, B free (mass, mounting, signs) and b the zero. For given d it is linear in B and b; all that its fit
needs are the second moments of f, R' a and the columns of R', so that any number of directions costs one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.gravity.rotation_terms import without_terms
from modeling.kinematics.base_mounting import Direction

Array = NDArray[np.float64]

GRID = 240
"""Directions from which the best is refined, 13 degrees apart on the sphere."""
FIRST_STEP, LAST_STEP, MAX_STEPS = 0.1, 1e-4, 100
"""Of the refinement, rad; a step that takes the rounding of the residual for its slope errs by a thousandth of it."""


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
        """Unit vector (d,) of the smallest residual: the best of a grid, refined in its tangent plane.

        Newton's method with differences over a stencil, which shrinks once it holds the minimum; `scipy.optimize` has
        such methods too, but its import takes longer than reading a recording.
        """
        directions = _grid(self.axes)
        best = directions[int(np.argmin(self._squares(directions)))]
        stencil, step = np.array(list(product((-1.0, 0.0, 1.0), repeat=self.axes - 1))), FIRST_STEP
        for _ in range(MAX_STEPS):
            across = step * np.linalg.svd(best[None])[2][1:]
            lowest = _lowest_point(stencil, self._squares(_unit(best + stencil @ across)))
            best = _unit(best + lowest @ across)
            step = step if np.abs(lowest).max() == 1 else step / 4
            if step < LAST_STEP:
                break
        return np.asarray(best)

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


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _lowest_point(stencil: Array, values: Array) -> Array:
    """Where the parabola through `values` (m,) at `stencil` points (m, k) is lowest, at most 1 away in any direction.

    Of a parabola without a minimum it is the lowest of the points.
    """
    first, second = np.triu_indices(stencil.shape[1])
    terms = np.column_stack([np.ones(len(stencil)), stencil, stencil[:, first] * stencil[:, second]])
    _, *coefficients = np.linalg.lstsq(terms, values - values.min(), rcond=None)[0]
    slope, curvature = np.array(coefficients[: stencil.shape[1]]), np.zeros((stencil.shape[1],) * 2)
    curvature[first, second] = coefficients[stencil.shape[1] :]
    curvature += curvature.T
    if np.linalg.eigvalsh(curvature)[0] <= 0:
        return np.asarray(stencil[int(np.argmin(values))])
    vertex = -np.linalg.solve(curvature, slope)
    return np.asarray(vertex / max(np.abs(vertex).max(), 1.0))


def _grid(axes: int) -> Array:
    """Unit vectors: every 5 degrees of the circle, or a Fibonacci lattice of the sphere."""
    if axes == 2:
        angles = np.arange(0, 360, 5) * np.pi / 180
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    number = np.arange(GRID)
    z, turn = 1 - (2 * number + 1) / GRID, np.pi * (3 - np.sqrt(5)) * number
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
