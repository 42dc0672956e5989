"""Score tests at one point of an effect's grid: scores, the noise that they are in, and p-values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import detectable_noncentrality
from estimation.noise.noise_level import NoiseLevel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointScore:
    """Score test of an effect's amplitudes at one point of its grid.

    score         drop of the whitened chi-square, with `rank` degrees of freedom
    amounts, std  estimate and standard deviation of each amplitude, (a,), in units of the grid point
    """

    score: float
    rank: int
    amounts: Array
    std: Array


@dataclass(frozen=True)
class AmplitudeTest:
    """Score test of one amplitude, the others zero: that of the largest score among `amplitudes`."""

    score: float
    noise: NoiseLevel
    amplitudes: int


@dataclass(frozen=True, eq=False)
class PointTest:
    """Score tests of an effect's amplitudes at one point of its grid: of all together, and of the strongest alone.

    Where one of many amplitudes is real, the test of all spreads its score over them; and in a single run they take so
    many of the lowest lines that the rest hardly tell the noise there. Tested alone it is found (sparse alternatives:
    Arias-Castro, Candes and Plan, Annals of Statistics 39, 2011).

    score     of all amplitudes
    noise     level of the noise where that score comes from
    alone     test of the strongest amplitude; None where there is but one direction
    power     level of the noise (a,) where the score of each amplitude comes from
    variance  variances (a,) of their logs
    """

    score: PointScore
    noise: NoiseLevel
    alone: AmplitudeTest | None
    power: Array
    variance: Array

    def p_value(self, from_motion: float = 0.0) -> float:
        """P-value of both tests (Bonferroni), of what is beyond the score that the noise of the motion gives by itself.

        A score is a squared length, to which the noise of the motion adds its own, at most in the same direction.
        1 where the effect is not identifiable.
        """
        if not self.score.rank:
            return 1.0
        together = self.noise.p_value(_less(self.score.score, from_motion), self.score.rank)
        if self.alone is None:
            return together
        strongest = self.alone.amplitudes * self.alone.noise.p_value(_less(self.alone.score, from_motion), 1)
        return min(1.0, 2 * together, 2 * strongest)

    def detectable_noncentrality(self, level: float) -> Array:
        """Noncentrality (a,) that one of the tests at this level detects with 80 % power."""
        if self.alone is None:
            return np.asarray(detectable_noncentrality([self.score.rank], [level], self.variance)[0])
        levels = [level / 2, level / 2 / self.alone.amplitudes]
        return np.asarray(detectable_noncentrality([self.score.rank, 1], levels, self.variance).min(axis=0))


def _less(score: float, other: float) -> float:
    """A squared length less another of the same direction."""
    return float(max(score**0.5 - other**0.5, 0.0) ** 2)
