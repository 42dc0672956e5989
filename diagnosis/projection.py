"""Projection: what an effect's columns would bring beside all that a model can do already."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from estimation.linear.descent import FAINT

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-4
"""Share of a column that must be left after projection; less is a derivative's rounding, not a direction."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What the columns of an effect's amplitudes would bring at one nuisance value.

    score   drop of the whitened chi-square, with `rank` degrees of freedom
    amounts, std  per amplitude, (a,), in its unit
    doubt   variance of the logarithm of the noise's power where the score comes from
    """

    score: float
    rank: int
    amounts: Array
    std: Array
    doubt: float


@dataclass(frozen=True, eq=False)
class Projected:
    """Columns (rows, g, a) of one effect's a amplitudes at g nuisance values, less what the model does already.

    Each group is scaled to columns of unit length and brought to its principal directions, of which those with
    less than RANK_TOLERANCE left are no directions. `low` bounds a single amplitude from below.
    """

    background: Background
    columns: Array
    low: float

    @cached_property
    def rows(self) -> slice:
        """The rows that any column reaches."""
        reached = np.flatnonzero(self.columns.any(axis=(1, 2)))
        return slice(0, int(reached[-1]) + 1 if len(reached) else 1)

    @cached_property
    def scale(self) -> Array:
        """Length of each column, (g, a); without end where it is rounding only, so that nothing is made of it."""
        length = np.linalg.norm(self.columns, axis=0)
        return np.asarray(np.where(length > FAINT, length, np.inf))

    @cached_property
    def free(self) -> Array:
        """Unit columns less their part in the model's own directions; whole rows, (rows, g, a)."""
        unit = self.columns / self.scale
        basis = self.background.basis
        along = np.tensordot(basis[self.rows], unit[self.rows], axes=(0, 0))
        return np.asarray(unit - np.tensordot(basis, along, axes=(1, 0)))

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Inverse roots (g, a, a) that make the free columns orthonormal, zero where there is none; ranks (g,)."""
        gram = np.einsum("rga,rgb->gab", self.free, self.free, optimize=True)
        values, vectors = np.linalg.eigh(gram)
        kept = values > RANK_TOLERANCE**2
        inverse = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return vectors * inverse[:, None, :], kept.sum(axis=1)

    def scores(self, rows: Array) -> tuple[Array, Array]:
        """Chi-square drop (g, m) and amounts (g, a, m) for residual rows (rows, m) free of the model's directions.

        The free columns and the unit columns have the same product with such residuals.
        """
        unit = self.columns[self.rows] / self.scale
        product = np.tensordot(unit, rows[self.rows], axes=(0, 0))
        roots, _ = self.directions
        along = np.einsum("gab,gam->gbm", roots, product)
        amounts = np.einsum("gab,gbm->gam", roots, along) / self.scale[:, :, None]
        score = (along**2).sum(axis=1)
        if np.isfinite(self.low):
            score = np.where(amounts[:, 0] > self.low, score, 0.0)
        return score, amounts

    @cached_property
    def trials(self) -> list[Trial]:
        """One per nuisance value."""
        score, amounts = self.scores(self.background.residual[:, None])
        roots, rank = self.directions
        size = np.linalg.norm(roots, axis=2)
        std = np.where(size > 0, size / self.scale, np.inf)
        seen = np.isfinite(self.scale)
        along = np.where(seen, amounts[:, :, 0] * np.where(seen, self.scale, 0.0), 0.0)
        doubt = self.background.doubt_of(np.einsum("rga,ga->rg", self.free, along))
        return [
            Trial(float(score[g, 0]), int(rank[g]), amounts[g, :, 0], std[g], float(doubt[g])) for g in range(len(rank))
        ]

    def noise_scores(self) -> Array:
        """The largest score of these columns in draws of pure noise, (DRAWS,)."""
        score, _ = self.scores(self.background.draws)
        return np.asarray(score.max(axis=0))
