"""Projection of score columns onto the complement of the null model; score statistics and estimated amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import (
    BatchedColumns,
    NullModel,
    RowChoice,
    RowRanges,
    WhitenedColumns,
    row_index,
    row_ranges,
)
from estimation.least_squares.levenberg_marquardt import NEGLIGIBLE_COLUMN_LENGTH
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.multiplicity import detectable_noncentrality
from estimation.noise.whitened_spectrum import NoiseLevel, WhitenedSpectrum, lines
from modeling.chain.effect import GridSuperposition
from modeling.noise import NoiseSource

# Columns of a score test in the rows that they reach, and the level of the noise there.


Array = NDArray[np.float64]


def columns_beside(null_model: NullModel, columns: Array, choice: RowChoice) -> tuple[Array, RowRanges]:
    """Columns (r, a) in chosen rows projected onto the complement of a null model, in the rows where they are not zero.

    The rows are ranges (first, after the last) of each recording: all of one whose spectrum is that of its residual.
    """
    noise, ranges = null_model.fit.noise, _reached_ranges(null_model, choice)
    free = np.zeros((sum(last - first for first, last in ranges), columns.shape[1]), order="F")
    free[_places(row_ranges(choice, noise), ranges)] = columns
    basis = null_model.column_space.basis_in(row_index(ranges, noise))
    free -= basis @ (basis.T @ free)
    return free, ranges


def noise_levels(null_model: NullModel, ranges: RowRanges, fitted: Array, tested: Array) -> list[NoiseLevel]:
    """Level of the noise's spectrum over that which whitens, where each column (r, g) has its power.

    The columns are in the rows `ranges`, and projected. Of a single run the spectrum is that of the residual without
    the `tested` columns (r, a), which are no part of the noise if they are real.
    """
    shares = fitted**2
    power = shares.sum(axis=0)
    shares /= np.where(power > 0, power, 1.0)
    levels = [NoiseLevel(known=float(size == 0)) for size in power]
    residual, directions = null_model.residual[row_index(ranges, null_model.fit.noise)], tested[:, :0]
    if not null_model.spectrum_is_known:
        directions = ColumnSpace.of(tested).basis
        residual = residual - directions @ (directions.T @ residual)
    ends = pairwise(np.cumsum([0, *(last - first for first, last in ranges)]).tolist())
    each = zip(null_model.fit.noise, null_model.line_leverage, ranges, ends, strict=True)
    for noise, leverage, (first_row, _), (start, end) in each:
        share, variance = shares[start:end].sum(axis=0), noise.log_power_variance_of(shares[start:end], first_row)
        if leverage is None:
            of_own = shares[start:end] / np.where(share > 0, share, 1.0)
            share = share * noise.error_of_weights(of_own, first_row)
            levels = [x.and_known(*more) for x, *more in zip(levels, share, variance, strict=True)]
            continue
        taken = leverage + (lines(directions[start:end], leverage.shape[1]) ** 2).sum(axis=2)
        stated = noise.source is NoiseSource.RIG
        spectrum = WhitenedSpectrum.of(residual[start:end], taken, stated=stated)
        unit = fitted[start:end] / np.sqrt(np.where(power > 0, power, 1.0))
        uncertain = spectrum.power_along(unit).transpose(2, 1, 0)
        levels = [
            x.and_parts(level, spectrum.probability.T, v)
            for x, level, v in zip(levels, uncertain, variance + 2 * share**2 / spectrum.rows, strict=True)
        ]
    return levels


def _reached_ranges(null_model: NullModel, choice: RowChoice) -> RowRanges:
    """The rows of each recording outside which columns of the chosen rows stay zero when they are projected.

    All rows of a recording whose spectrum is that of its residual.
    """
    chosen, ends = row_ranges(choice, null_model.fit.noise), null_model.reached_ends
    changed = any(first < end and last > first for (first, last), end in zip(chosen, ends, strict=True))
    ranges = []
    for noise, leverage, rows, end in zip(null_model.fit.noise, null_model.line_leverage, chosen, ends, strict=True):
        if leverage is not None:
            ranges.append((0, noise.whitener.rows))
        else:
            ranges.append((0, max(rows[1], end)) if changed and end else rows)
    return tuple(ranges)


def _places(chosen: RowRanges, ranges: RowRanges) -> slice | NDArray[np.intp]:
    """Where chosen rows are among those of wider ranges."""
    if chosen == ranges:
        return slice(None)
    starts = np.cumsum([0, *(last - first for first, last in ranges)]).tolist()
    return np.concatenate(
        [
            np.arange(start + rows[0] - wider[0], start + rows[1] - wider[0])
            for rows, wider, start in zip(chosen, ranges, starts[:-1], strict=True)
        ]
    )


# Score tests at one point of an effect's grid: scores, the noise that they are in, and p-values.


@dataclass(frozen=True)
class Score:
    """Drop of the whitened chi-square, with `rank` degrees of freedom, in noise of some level there.

    It is the largest of that of so many `tests`.
    """

    value: float
    rank: int
    noise: NoiseLevel
    tests: int = 1

    def p_value(self, from_motion: float = 0.0) -> float:
        """P-value (Bonferroni) of what is beyond the score that the noise of the motion gives by itself.

        A score is a squared length, to which the noise of the motion adds its own, at most in the same direction.
        """
        beyond = max(self.value**0.5 - from_motion**0.5, 0.0) ** 2
        return self.tests * self.noise.p_value(float(beyond), self.rank)


@dataclass(frozen=True, eq=False)
class PointTest:
    """Score tests of an effect's amplitudes at one point of its grid: of all together, and of the strongest alone.

    Where one of many amplitudes is real, the test of all spreads its score over them; and in a single run they take so
    many of the lowest lines that the rest hardly tell the noise there. Tested alone it is found (sparse alternatives:
    Arias-Castro, Candes and Plan, Annals of Statistics 39, 2011).

    together      of all amplitudes
    alone         of the strongest amplitude, the others zero; None where there is but one direction
    amounts, std  estimate and standard deviation of each amplitude, (a,), in units of the grid point
    power         level of the noise (a,) where the score of each amplitude comes from
    variance      variances (a,) of their logs
    """

    together: Score
    alone: Score | None
    amounts: Array
    std: Array
    power: Array
    variance: Array

    def p_value(self, from_motion: float = 0.0) -> float:
        """P-value of both tests (Bonferroni), beyond the score that the noise of the motion gives by itself.

        1 where the effect is not identifiable.
        """
        if not self.together.rank:
            return 1.0
        together = self.together.p_value(from_motion)
        return together if self.alone is None else min(1.0, 2 * together, 2 * self.alone.p_value(from_motion))

    def detectable_noncentrality(self, level: float) -> Array:
        """Noncentrality (a,) that one of the tests at this level detects with 80 % power."""
        if self.alone is None:
            return np.asarray(detectable_noncentrality([self.together.rank], [level], self.variance)[0])
        levels = [level / 2, level / 2 / self.alone.tests]
        return np.asarray(detectable_noncentrality([self.together.rank, 1], levels, self.variance).min(axis=0))


RANK_TOLERANCE = 1e-4
"""Relative length of a projected direction below which it counts as rounding error of the derivative."""


@dataclass(frozen=True, eq=False)
class ProjectedColumns:
    """Score columns of an effect at its grid points, projected onto the complement of the null model.

    The columns of a point are linear combinations of building blocks' (`combination`), and so are their inner products.
    Those of each point are scaled to unit length and decomposed into principal directions; directions shorter than
    RANK_TOLERANCE after projection are dropped. `low` is the lower bound of a single amplitude.
    """

    null_model: NullModel
    whitened: WhitenedColumns | BatchedColumns
    combination: GridSuperposition
    low: float

    @classmethod
    def of_point(
        cls, null_model: NullModel, columns: Array, choice: RowChoice, low: float = -np.inf
    ) -> ProjectedColumns:
        """Of the columns (r, 1, a) of a single point, in the chosen rows."""
        return cls(null_model, WhitenedColumns(columns, choice), GridSuperposition.plain([{}]), low)

    @cached_property
    def _index(self) -> NDArray[np.intp]:
        return np.array(self.combination.index, dtype=np.intp)

    @cached_property
    def _weights(self) -> Array:
        return np.array(self.combination.weights)

    def _summed(self, blocks: Array) -> Array:
        """Quantities at the points (g, ...) from those of the blocks (b, ...), linear in the columns."""
        if self._index.shape[1] == 1 and len(self._index) == len(blocks):
            return blocks  # every point is its own block
        return np.asarray(np.einsum("gs,gs...->g...", self._weights, blocks[self._index]))

    @cached_property
    def gram(self) -> Array:
        """Inner products (g, a, a) of the points' columns."""
        if self._index.shape[1] == 1:
            return self._summed(self.whitened.block_gram)
        pairs = self.whitened.gram[self._index[:, :, None], :, self._index[:, None, :], :]
        return np.asarray(np.einsum("gs,gt,gstab->gab", self._weights, self._weights, pairs))

    @cached_property
    def scale(self) -> Array:
        """Length of each column (g, a); infinite where it is rounding error only, so that the column drops out."""
        length = np.sqrt(np.maximum(np.diagonal(self.gram, axis1=1, axis2=2), 0.0))
        return np.asarray(np.where(length > NEGLIGIBLE_COLUMN_LENGTH, length, np.inf))

    @cached_property
    def _null_components(self) -> Array:
        """Components (g, a, k) of the unit columns along the null model's basis."""
        return self._summed(self.whitened.along_basis(self.null_model)) / self.scale[:, :, None]

    @cached_property
    def _principal(self) -> tuple[Array, NDArray[np.int_]]:
        """Inverse square roots (g, a, a) of the projected Gram matrices, zero in dropped directions; ranks (g,)."""
        unit = self.gram / self.scale[:, :, None] / self.scale[:, None, :]
        free = unit - self._null_components @ self._null_components.swapaxes(1, 2)
        if free.shape[1] == 1:
            values, vectors = free[:, :, 0], np.ones_like(free)
        else:
            values, vectors = np.linalg.eigh(free)
        kept = values > RANK_TOLERANCE**2
        inverse = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return vectors * inverse[:, None, :], kept.sum(axis=1)

    @property
    def roots(self) -> Array:
        """Inverse square roots (g, a, a) of the projected Gram matrices of unit columns, zero in dropped directions."""
        return self._principal[0]

    @property
    def ranks(self) -> NDArray[np.int_]:
        """Number (g,) of directions that are not dropped."""
        return self._principal[1]

    def _scored(self, product: Array) -> tuple[Array, Array]:
        """Scores (g, m) and amounts (g, a, m) from inner products (g, a, m) of unit columns and projected residuals."""
        along = self.roots.swapaxes(1, 2) @ product
        amounts = (self.roots @ along) / self.scale[:, :, None]
        score = (along**2).sum(axis=1)
        if np.isfinite(self.low):
            score = np.where(amounts[:, 0] > self.low, score, 0.0)
        return score, amounts

    @cached_property
    def _of_residual(self) -> tuple[Array, Array]:
        product = self._summed(self.whitened.along_residual(self.null_model)) / self.scale[:, :, None]
        return self._scored(product)

    @property
    def scores(self) -> Array:
        """Scores (g,) of the residual."""
        return self._of_residual[0][:, 0]

    @property
    def amounts(self) -> Array:
        """Estimated amounts (g, a)."""
        return self._of_residual[1][:, :, 0]

    @cached_property
    def std(self) -> Array:
        """Standard deviations (g, a) of the amounts."""
        size = np.linalg.norm(self.roots, axis=2)
        return np.asarray(np.where(size > 0, size / self.scale, np.inf))

    @property
    def best(self) -> int:
        """Index of the largest score; where all are zero, of a point where the effect is identifiable."""
        return int(np.lexsort((-np.arange(len(self.scores)), self.ranks, self.scores))[-1])

    def noise_scores(self) -> Array:
        """The largest score over the grid in each noise draw, (NOISE_DRAWS,)."""
        return np.asarray(self.noise_scores_by_point().max(axis=0))

    def noise_scores_by_point(self) -> Array:
        """The scores (g, NOISE_DRAWS) of noise draws."""
        null_model, choice = self.null_model, self.whitened.choice
        products = self.whitened.noise_inner_products(null_model.draws[null_model.index(choice)])
        raw = self._summed(products) / self.scale[:, :, None]
        if self._null_components.shape[2]:
            raw = raw - self._null_components @ null_model.draws_in_basis
        return self._scored(raw)[0]

    def columns(self, place: int) -> Array:
        """The score columns (r, a) of one point."""
        blocks = self.whitened.of_blocks(self._index[place])
        return np.asarray(np.einsum("s,rsa->ra", self._weights[place], blocks))

    def test(self, place: int) -> PointTest:
        """The score tests at one of the points, in the noise where their scores come from."""
        amounts, rank, present = self.amounts[place], int(self.ranks[place]), np.isfinite(self.scale[place])
        free, ranges = columns_beside(self.null_model, self.columns(place), self.whitened.choice)
        fitted = np.empty((len(free), 1 + free.shape[1]), order="F")
        fitted[:, 0], fitted[:, 1:] = free[:, present] @ amounts[present], free
        noise, *each = noise_levels(self.null_model, ranges, fitted, free[:, present])
        power, variance = np.array([x.mean for x in each]), np.array([x.variance_of_log for x in each])
        alone = self._strongest_alone(place, free, ranges, each) if rank > 1 else None
        together = Score(float(self.scores[place]), rank, noise)
        return PointTest(together, alone, amounts, self.std[place], power, variance)

    def _strongest_alone(self, place: int, free: Array, ranges: RowRanges, levels: Sequence[NoiseLevel]) -> Score:
        """Of a point's projected columns (r, a) the one of the largest score relative to the noise, of these levels."""
        residual = self.null_model.residual[row_index(ranges, self.null_model.fit.noise)]
        length = np.sqrt(np.einsum("ra,ra->a", free, free))
        identifiable = length > RANK_TOLERANCE * self.scale[place]
        scores = (free.T @ residual / np.where(identifiable, length, np.inf)) ** 2
        strongest = int(np.argmax(scores / np.array([level.mean for level in levels])))
        noise, column = levels[strongest], free[:, [strongest]]
        if not self.null_model.spectrum_is_known:  # spectrum of the residual without this one column
            (noise,) = noise_levels(self.null_model, ranges, column, column)
        return Score(float(scores[strongest]), 1, noise, int(identifiable.sum()))
