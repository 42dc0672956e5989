"""Direction of gravity in base axes, estimated from how the tool's weight turns with the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product
from math import acos, radians
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import orthonormal_basis
from estimation.recordings.recording import Recording
from estimation.recordings.weight_fit import WeightFit
from modeling.kinematics.placement import Direction
from modeling.rig import Convention

Array = NDArray[np.float64]


def rotation_terms(recording: Recording, every: slice) -> Array:
    """Angular accelerations and products of angular velocities (n, k) in these rows: m (alpha x r + omega x omega x r)
    is made of them."""
    signals = recording.signals
    if recording.dimension == 2:
        return np.stack([signals["ddphi"][every], signals["dphi"][every] ** 2], axis=1)
    omega, alpha = ([signals[prefix + axis][every] for axis in "xyz"] for prefix in ("w", "al"))
    products = [first * second for first, second in combinations_with_replacement(omega, 2)]
    return np.stack([*alpha, *products], axis=1)


def without_terms(rows: Array, terms: Array) -> Array:
    """What the terms (n, k), fitted by least squares with a constant, leave of rows (n, m).

    A fit of what is left to what is left is that of a fit with these terms (Frisch and Waugh, Econometrica 1, 1933).
    """
    rows, basis = rows - rows.mean(axis=0), orthonormal_basis(terms - terms.mean(axis=0))
    return np.asarray(rows - basis @ (basis.T @ rows))


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

    From them the tool's weight is fitted for any direction of gravity in base axes, in one pass. A rigid tool's force
    turns with the sensor: f = B R' (a - g d) + b with R the orientation and a the acceleration in base axes, g d
    gravity, B free (mass, mounting, signs) and b the zero. For given d it is linear in B and b.

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
        eye = np.eye(self.axes)
        regressor = np.vstack([eye, *(-self.gravity * c * eye for c in direction)])
        inputs = self.gram[: -self.axes, : -self.axes]
        mixed = regressor.T @ self.gram[: -self.axes, -self.axes :]
        solution = np.linalg.lstsq(regressor.T @ inputs @ regressor, mixed, rcond=1e-10)[0]
        residual = self.force**2 - float(np.sum(solution * mixed)) / (self.axes * self.recordings)
        return FreeFit(matrix=np.asarray(solution.T, dtype=np.float64), rms=float(np.sqrt(max(residual, 0.0))))

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
        regressors = np.stack([np.vstack([eye, *(-self.gravity * c * eye for c in d)]) for d in directions])
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


ALIKE = 2.0
"""Ratio of residuals up to which an axis explains the readings about as well as a direction a few degrees beside it."""
TILT = radians(15)
"""A base within this angle of the vertical stands upright, or hangs: the rest is left to the effect `gravity_tilt`."""
NEAR_AXIS = radians(5)
"""Within it an axis that explains the readings about as well is the direction."""
UNLIKE = radians(30)
"""A direction further than this from the best is another one, which must not explain the readings as well."""
FEWEST_POSES = 10
"""Samples from which a direction is estimated: it has two parameters more than a mass, its mounting and its zero."""
SIGN_SIGNIFICANCE = 5.0
"""Std between gravity along a direction and against it, by the accelerations, from which they decide."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityEstimate:
    """The direction of gravity with its evidence, beside that of a base that stands upright.

    direction   unit vector in base axes: the axis that it is next to, or as estimated
    rival       the best of the directions that are unlike it: where that explains as much, none is identifiable
    fit         with gravity along it; `upright` with gravity down
    decided     whether accelerations decide between it and its opposite; poses at rest cannot
    mounted     the direction before it was turned by the tilt that a fit found beside the tool; None if it was not
    cable       the fit of an upright base with a cable on the tool, where that explains the forces as well, so that
                gravity is taken as down; else None
    base_force  whether a force that is constant in base axes explains the readings better: gravity is taken as down
    """

    direction: Direction
    rival: Direction
    fit: FreeFit
    upright: FreeFit
    decided: bool
    mounted: Direction | None = None
    cable: WeightFit | None = None
    base_force: bool = False

    @property
    def is_doubted(self) -> bool:
        """Whether physics on a level base explains the readings as well, so that gravity is taken as down."""
        return self.cable is not None or self.base_force

    @property
    def is_upright(self) -> bool:
        """Whether gravity points down, or nearly."""
        return self.direction == upright_direction(len(self.direction))

    @property
    def along_axis(self) -> bool:
        """Whether it is an axis of the base."""
        return max(map(abs, self.direction)) == 1.0

    @property
    def place(self) -> str:
        """The direction in words: `along x of the base`."""
        words = direction_in_words(self.direction)
        if self.decided:
            return f"{words} of the base"
        return f"{words} of the base (or opposite, with the other sign convention: poses at rest cannot tell)"

    @property
    def evidence(self) -> str:
        """Mass and residual with it and without."""
        gain = f"with its direction free the mass is {self.fit.mass:.3g} kg and the residual of the weight falls from"
        return f"{gain} {self.upright.rms:.3g} to {self.fit.rms:.3g} N"

    @property
    def sentence(self) -> str:
        """What was found, as a sentence."""
        tilted = "" if self.mounted is None else ", with the tilt that was fitted beside the tool"
        return f"Gravity points {self.place}{tilted}: {self.evidence} (upright: {self.upright.mass:.3g} kg)."

    @property
    def not_applied(self) -> str:
        """Why gravity is taken as down nevertheless, as a sentence; empty where it is not."""
        if not self.is_doubted:
            return ""
        other = "a force that is constant in base axes explains the readings better, as of a zero that was taken there"
        if self.cable is not None:
            other = f"a cable that pulls the tool explains the forces as well, with {self.cable.mass:.3g} kg"
        remedy = f"If the base is mounted so, write {self.stated} under [robot] in the rig."
        return f"Gravity is taken as down, though it may point {self.place}: {self.evidence}, but {other}. {remedy}"

    @property
    def meaning(self) -> str:
        """What the readings may show, in words: gravity's direction, or the cable or the force instead of it."""
        if self.base_force:
            return (
                f"a force is constant in base axes, as of a zero that was taken there, or gravity points {self.place}"
            )
        if self.cable is None:
            return f"gravity points {self.place}"
        size = f"{self.cable.mass:.3g} kg, residual {self.cable.rms:.3g} N"
        return f"a cable pulls the tool ({size}), or gravity points {self.place}"

    @property
    def advice(self) -> str:
        """What to do about it."""
        line = f"state {self.stated} under [robot] in the rig"
        return f"gravity is taken as down; if the base is mounted so, {line}" if self.is_doubted else line

    @property
    def stated(self) -> str:
        """The line of a rig file that states it."""
        return f"gravity_direction = [{', '.join(f'{c:.4g}' for c in self.direction)}]"

    def to_data(self) -> dict[str, Any]:
        """The finding as data: kg and N, with the direction and with gravity down."""
        return {
            "direction": list(self.direction),
            "mounted": None if self.mounted is None else list(self.mounted),
            "decided": self.decided,
            "mass": self.fit.mass,
            "rms": self.fit.rms,
            "mass_upright": self.upright.mass,
            "rms_upright": self.upright.rms,
        }


def upright_direction(axes: int) -> Direction:
    """Gravity in base axes where the base stands upright: along -y in the plane, -z in six axes."""
    return (0.0, -1.0) if axes == 2 else (0.0, 0.0, -1.0)


def independent_samples(samples: int, *, at_rest: bool) -> int:
    """All poses, and a thousandth of a run (its residual is strongly correlated)."""
    return samples if at_rest else max(5, samples // 1000)


def direction_in_words(direction: Direction) -> str:
    """`along -x`, or `along (0.50, 0.00, -0.87)`."""
    axis = int(np.argmax(np.abs(direction)))
    if abs(direction[axis]) == 1.0:
        return f"along {'-' if direction[axis] < 0 else ''}{'xyz'[axis]}"
    return f"along ({', '.join(f'{c + 0.0:.2f}' for c in direction)})"


def estimated_gravity(
    moments: WeightMoments,
    independent: int,
    convention: Convention = Convention.AUTO,
    *,
    near_axis: float = NEAR_AXIS,
) -> GravityEstimate:
    """The direction of gravity in base axes; whether it is shown, `gravity_evidence` tests.

    With B and d, -B and -d fit the weight alike, and only accelerations distinguish them, by the likelihood of
    `independent` samples. Where they do not, the convention does; where it is not stated, gravity points rather down
    than up, and sideways the readings are ON_SENSOR, as those of most commercial sensors. Within `near_axis` (rad) of a
    level axis that explains the readings about as well, the direction is that axis.
    """
    best = moments.best_direction
    fit, opposite = moments.fit(best), moments.fit(-best)
    gain = independent * ((opposite.rms / max(fit.rms, 1e-300)) ** 2 - 1)
    decided = bool(gain > SIGN_SIGNIFICANCE**2)
    direction = _snapped(best, moments, near_axis)
    if not decided and _is_opposite(direction, fit, convention):
        direction = tuple(-c + 0.0 for c in direction)
    return GravityEstimate(
        direction=direction,
        rival=_plain(moments.rival(best, UNLIKE)),
        fit=moments.fit(direction),
        upright=moments.fit(upright_direction(moments.axes)),
        decided=decided,
    )


def _snapped(direction: Array, moments: WeightMoments, near_axis: float) -> Direction:
    """The axis next to a direction: where that is vertical, or where it explains the readings about as well."""
    number = int(np.argmax(np.abs(direction)))
    axis = np.sign(direction[number]) * np.eye(len(direction))[number]
    angle, vertical = acos(min(1.0, float(axis @ direction))), number == len(direction) - 1
    alike = moments.fit(axis).rms < ALIKE * moments.fit(direction).rms
    return _plain(axis if angle < (TILT if vertical else near_axis) and (vertical or alike) else direction)


def _plain(direction: Array) -> Direction:
    return tuple(float(component) + 0.0 for component in direction)


def _is_opposite(direction: Direction, fit: FreeFit, convention: Convention) -> bool:
    """Whether the opposite direction is meant, of two that the data do not distinguish."""
    on_tool = float(np.linalg.det(fit.matrix)) > 0
    if convention is not Convention.AUTO:
        return on_tool is not (convention is Convention.ON_TOOL)
    if abs(direction[-1]) > np.sin(TILT):
        return direction[-1] > 0
    return on_tool
