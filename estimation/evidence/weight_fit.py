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

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import student_isf
from modeling.significance import LEVELS

Array: TypeAlias = NDArray[np.float64]

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
        return 1 - float(self.squares.mean()) / max(self.power, 1e-300)

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
        deviation = max(float(ratios.std(ddof=1)), 1e-9) / np.sqrt(len(ratios))
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
    return max(float(square), 1e-30)
