"""Weight fit: the force of a rigid tool whose mounting is unknown, in closed form; and which of two readings it shows.

f = m Q d + b: d (n, k) is the specific force in the sensor, in m/s², Q an orthogonal matrix, b the zero. Mass and Q
follow from the singular values of the cross-covariance (Schönemann, "A generalized solution of the orthogonal
Procrustes problem", 1966). Of a proper Q the readings are the sensor's force on the tool, of an improper one the
tool's on the sensor; a mounting that is free otherwise leaves the number of parameters alike for every reading, and a
wrong reading has no freedom to bend B = m Q towards the readings, as a free matrix would.

Two readings are compared by Vuong's test ("Likelihood ratio tests for model selection and non-nested hypotheses",
1989), which asks which of two models is closer to the truth though neither need be true: a hidden effect is part of
both residuals. Residuals of a motion are correlated for as long as the motion is, so that the likelihood ratio is taken
in contiguous blocks, and its deviation is theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import student_isf
from modeling.significance import LEVELS

Array = NDArray[np.float64]

BLOCKS = 10
"""Of a run of some periods: as long as the motion's correlation, and enough of them for a variance."""
LEAST_EXPLAINED = 0.6
"""Share of the readings' power that another reading has to explain: with less, most of the force is no weight, and
what it resembles means little. In simulations the right reading explains more in 99 of 100 recordings without a hand
on the tool (random rigs, each with a hidden effect of any kind)."""
LEAST_WEIGHT = 0.5
"""Share of the readings' power below which most of the force is no weight that turns with the sensor."""
LEAST_MASS = 0.03
"""kg: less than the plate by which a tool is fastened to a sensor."""
FEWEST_BLOCKS = 3
"""Fewer hardly have a variance."""
SMALLEST_DIVISOR = 1e-300
"""In place of a divisor of zero, such as the power of a channel that never changes: far below any square measured."""
RANK_TOLERANCE = 1e-10
"""Of the largest singular value: smaller ones are rounding of a regressor that is none."""
SMALLEST_SQUARE = 1e-30
"""N²: below the square of any force that is resolved, so that logarithms of a perfect fit are finite."""
SMALLEST_SPREAD = 1e-9
"""Of logarithms of ratios, which are the same in all blocks of simulated readings without noise."""
SHORTEST_CABLE = 1e-9
"""Metres, in place of a cable's length of zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightFit:
    """Mass in kg, mounting Q (k, k), and the squared residual (n,) of each sample, N², summed over the channels.

    power  N², mean square of the readings about their mean, summed over the channels
    """

    mass: float
    mounting: Array
    squares: Array
    power: float

    @property
    def rms(self) -> float:
        """Of the residual in one channel, N."""
        return float(np.sqrt(self.squares.mean() / len(self.mounting)))

    @property
    def explained(self) -> float:
        """Share of the readings' power that the weight explains."""
        return 1 - float(self.squares.mean()) / max(self.power, SMALLEST_DIVISOR)

    def log_ratio(self, other: WeightFit) -> float:
        """ln of the other residual's rms over this one's."""
        return 0.5 * float(np.log(_positive(other.squares.mean()) / _positive(self.squares.mean())))

    def block_ratios(self, other: WeightFit, blocks: int = BLOCKS) -> Array:
        """`log_ratio` in each of the contiguous blocks."""
        pieces = np.array_split(np.arange(len(self.squares)), min(blocks, len(self.squares) // 2))
        means = [[_positive(fit.squares[piece].mean()) for piece in pieces] for fit in (self, other)]
        return np.asarray(0.5 * np.log(np.array(means[1]) / np.array(means[0])))

    def is_nearer_than(self, other: WeightFit, alternatives: int = 1) -> bool:
        """Whether this fit is nearer to the truth than another, significantly, of so many that were compared."""
        ratios = self.block_ratios(other)
        if len(ratios) < FEWEST_BLOCKS or ratios.mean() <= 0:
            return False
        deviation = max(float(ratios.std(ddof=1)), SMALLEST_SPREAD) / np.sqrt(len(ratios))
        level = LEVELS.misread / alternatives
        return bool(float(ratios.mean()) > deviation * float(student_isf(level, len(ratios) - 1)))

    def is_shown_against(self, other: WeightFit, alternatives: int = 1) -> bool:
        """Whether this fit is nearer to the truth, and explains enough of the readings to be true of them."""
        return self.explained > LEAST_EXPLAINED and self.is_nearer_than(other, alternatives)

    @property
    def shows_no_weight(self) -> bool:
        """Whether most of the force is no weight that turns with the sensor, or the weight that of no tool."""
        return self.explained < LEAST_WEIGHT or self.mass < LEAST_MASS


def weight_fit(direction: Array, force: Array, *, mounting: Array | None = None, sign: int = 0) -> WeightFit:
    """The fit of a force (n, k) by a specific force (n, k) in m/s², with a mounting (k, k) where it is known.

    `sign` is that of det Q, 0 for either.
    """
    d, f = direction - direction.mean(axis=0), force - force.mean(axis=0)
    covariance = f.T @ d
    if mounting is None:
        left, singular, right = np.linalg.svd(covariance)
        turned = np.ones(len(singular))
        if sign and np.sign(np.linalg.det(left @ right)) != sign:
            turned[-1] = -1.0
        mounting = left * turned @ right
    mass = max(float((covariance * mounting).sum()), 0.0) / _positive((d**2).sum())
    squares = ((f - mass * d @ mounting.T) ** 2).sum(axis=1)
    return WeightFit(mass=mass, mounting=mounting, squares=squares, power=float((f**2).sum(axis=1).mean()))


def _positive(square: float) -> float:
    return max(float(square), SMALLEST_SQUARE)


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

    A cable to a place in the cell pulls nearly one way in base axes, as gravity does: beside one, a level base looks as
    if it were not, and an aligned sensor as if it were turned. The inertia of the tool and the change of the pull along
    the path separate them. With u from the point of the tool where the cable is fastened to its anchor, the force is

        f = m Q (R' (a - g d) - s max(0, |u| - length) u / |u|) + b

    in which s is the stiffness per mass; for a given cable, m and Q follow in closed form (`weight_fit`). It is a rival
    of other readings: whether there is a cable, with its torque, is for the effect `cable_spring` to say.

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
        basis = left[:, sizes > RANK_TOLERANCE * sizes[0]]
        cleared = force[every] - basis @ (basis.T @ force[every])
        return cls(
            to_sensor=to_sensor[every], position=position[every], specific=specific[every], force=cleared, basis=basis
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
        candidates = [
            least_squares(self._residual, np.clip(start, low, high), bounds=(low, high), x_scale="jac", max_nfev=STEPS)
            for start in starts
        ]
        best = min(candidates, key=lambda one: float(one.cost))
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
        return np.asarray(
            stiffness * np.maximum(distance - length, 0.0) / np.maximum(distance, SHORTEST_CABLE) * vector
        )

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
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), SMALLEST_DIVISOR))
