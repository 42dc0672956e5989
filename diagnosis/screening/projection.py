"""Projection of score columns onto the complement of the null model; score statistics and estimated amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import NullModel, RowChoice, RowRanges, row_index, row_ranges
from estimation.least_squares.levenberg_marquardt import NEGLIGIBLE_COLUMN_LENGTH
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.multiplicity import detectable_noncentrality
from estimation.noise.whitened_spectrum import NoiseLevel, WhitenedSpectrum, lines
from modeling.chain.effect import GridSuperposition
from modeling.noise import NoiseSource

# Columns of a score test in the rows that they reach, and the level of the noise there.


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScoredColumns:
    """Columns (r, a) projected onto the complement of a null model, in the rows `ranges`; they are zero in all others.

    residual  of the null model in these rows, (r,)
    """

    null_model: NullModel
    columns: Array
    residual: Array
    ranges: RowRanges

    @classmethod
    def of(cls, null_model: NullModel, columns: Array, choice: RowChoice) -> ScoredColumns:
        """Of columns (r, a) in the chosen rows, not yet projected."""
        noise, ranges = null_model.fit.noise, _reached_ranges(null_model, choice)
        index = row_index(ranges, noise)
        free = np.zeros((sum(last - first for first, last in ranges), columns.shape[1]), order="F")
        free[_places(row_ranges(choice, noise), ranges)] = columns
        basis = null_model.column_space.basis_in(index)
        free -= basis @ (basis.T @ free)
        return cls(null_model, free, null_model.residual[index], ranges)

    def noise_levels(self, fitted: Array, tested: Array) -> list[NoiseLevel]:
        """Level of the noise's spectrum over that which whitens, where each column (r, g) has its power.

        The columns are in the rows `ranges`, and projected. Of a single run the spectrum is that of the residual
        without the `tested` columns (r, a), which are no part of the noise if they are real.
        """
        shares = fitted**2
        power = shares.sum(axis=0)
        shares /= np.where(power > 0, power, 1.0)
        found = [NoiseLevel(known=float(size == 0)) for size in power]
        leverages, residual, directions = self.null_model.line_leverage, self.residual, tested[:, :0]
        if not self.spectrum_is_known:
            directions = ColumnSpace.of(tested).basis
            residual = residual - directions @ (directions.T @ residual)
        ends = pairwise(np.cumsum([0, *(last - first for first, last in self.ranges)]).tolist())
        each = zip(self.null_model.fit.noise, leverages, self.ranges, ends, strict=True)
        for noise, leverage, (first_row, _), (start, end) in each:
            own, variance = shares[start:end].sum(axis=0), noise.log_power_variance_of(shares[start:end], first_row)
            if leverage is None:
                found = [x.and_known(*more) for x, *more in zip(found, own, variance, strict=True)]
                continue
            taken = leverage + (lines(directions[start:end], leverage.shape[1]) ** 2).sum(axis=2)
            stated = noise.source is NoiseSource.RIG
            spectrum = WhitenedSpectrum.of(residual[start:end], taken, stated=stated)
            unit = fitted[start:end] / np.sqrt(np.where(power > 0, power, 1.0))
            parts = spectrum.power_along(unit).transpose(2, 1, 0)
            found = [
                x.and_parts(level, spectrum.probability.T, v)
                for x, level, v in zip(found, parts, variance + 2 * own**2 / spectrum.rows, strict=True)
            ]
        return found

    @property
    def spectrum_is_known(self) -> bool:
        """Whether no recording's spectrum is that of its residual."""
        return all(leverage is None for leverage in self.null_model.line_leverage)


def _reached_ranges(null_model: NullModel, choice: RowChoice) -> RowRanges:
    """The rows of each recording outside which columns of the chosen rows stay zero when they are projected.

    All rows of a recording whose spectrum is that of its residual.
    """
    chosen, ends = row_ranges(choice, null_model.fit.noise), null_model.reached_ends
    changed = any(first < end and last > first for (first, last), end in zip(chosen, ends, strict=True))
    found = []
    for noise, leverage, own, end in zip(null_model.fit.noise, null_model.line_leverage, chosen, ends, strict=True):
        if leverage is not None:
            own = (0, noise.whitener.rows)
        elif changed and end:
            own = (0, max(own[1], end))
        found.append(own)
    return tuple(found)


def _places(chosen: RowRanges, ranges: RowRanges) -> slice | NDArray[np.intp]:
    """Where chosen rows are among those of wider ranges."""
    if chosen == ranges:
        return slice(None)
    starts = np.cumsum([0, *(last - first for first, last in ranges)]).tolist()
    parts = [
        np.arange(start + own[0] - whole[0], start + own[1] - whole[0])
        for own, whole, start in zip(chosen, ranges, starts[:-1], strict=True)
    ]
    return np.concatenate(parts)


# Score tests at one point of an effect's grid: scores, the noise that they are in, and p-values.


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


Draws = NDArray[np.float32]

RANK_TOLERANCE = 1e-4
"""Relative length of a projected direction below which it counts as rounding error of the derivative."""


@dataclass(frozen=True, eq=False)
class WhitenedColumns:
    """Score columns (r, b, a) of an effect's a amplitudes at b building blocks, in the rows `choice`.

    Their inner products with each other and with the noise draws do not depend on the fit and are computed once.
    """

    columns: Array
    choice: RowChoice

    @property
    def bytes(self) -> int:
        """Memory of the columns; that of quantities computed from them is small in comparison."""
        return self.columns.nbytes

    @cached_property
    def flat(self) -> Array:
        """The columns as a matrix, (r, b a)."""
        return self.columns.reshape(len(self.columns), -1)

    @cached_property
    def block_gram(self) -> Array:
        """Inner products of each block's columns, (b, a, a)."""
        if self.columns.shape[2] == 1:
            return np.asarray(np.einsum("rba,rba->ba", self.columns, self.columns)[:, :, None])
        each = self.columns.transpose(1, 2, 0)
        return np.asarray(each @ each.swapaxes(1, 2))

    @cached_property
    def gram(self) -> Array:
        """Inner products of all columns, (b, a, b, a)."""
        _, b, a = self.columns.shape
        return np.asarray(self.flat.T @ self.flat).reshape(b, a, b, a)

    def inner_products(self, rows: Array) -> Array:
        """Inner products (b, a, m) with other columns (r, m) of the same rows."""
        _, b, a = self.columns.shape
        return np.asarray(self.flat.T @ rows).reshape(b, a, rows.shape[1])

    def noise_inner_products(self, draws: Draws) -> Array:
        """Inner products (b, a, NOISE_DRAWS) with noise draws (r, NOISE_DRAWS) in these rows, computed once."""
        if "products" not in self._noise_inner_products:
            _, b, a = self.columns.shape
            products = self.flat.astype(draws.dtype).T @ draws
            self._noise_inner_products["products"] = products.astype(np.float64).reshape(b, a, -1)
        return self._noise_inner_products["products"]

    @cached_property
    def _noise_inner_products(self) -> dict[str, Array]:
        return {}


@dataclass(frozen=True, eq=False)
class ProjectedColumns:
    """Score columns of an effect at its grid points, projected onto the complement of the null model.

    The columns of a point are linear combinations of building blocks' (`combination`), and so are their inner products.
    Those of each point are scaled to unit length and decomposed into principal directions; directions shorter than
    RANK_TOLERANCE after projection are dropped. `low` is the lower bound of a single amplitude.
    """

    null_model: NullModel
    whitened: WhitenedColumns
    combination: GridSuperposition
    low: float

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
        null_rows = self.null_model.rows_of(self.whitened.choice)
        return self._summed(self.whitened.inner_products(null_rows.basis)) / self.scale[:, :, None]

    @cached_property
    def directions(self) -> tuple[Array, Array]:
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

    def _scores(self, product: Array) -> tuple[Array, Array]:
        """Scores (g, m) and amounts (g, a, m) from inner products (g, a, m) of unit columns and projected residuals."""
        roots, _ = self.directions
        along = roots.swapaxes(1, 2) @ product
        amounts = (roots @ along) / self.scale[:, :, None]
        score = (along**2).sum(axis=1)
        if np.isfinite(self.low):
            score = np.where(amounts[:, 0] > self.low, score, 0.0)
        return score, amounts

    @cached_property
    def found(self) -> tuple[Array, Array]:
        """Scores (g,) and estimated amounts (g, a) of the residual."""
        residual = self.null_model.rows_of(self.whitened.choice).residual
        product = self._summed(self.whitened.inner_products(residual[:, None])) / self.scale[:, :, None]
        score, amounts = self._scores(product)
        return score[:, 0], amounts[:, :, 0]

    @cached_property
    def std(self) -> Array:
        """Standard deviations (g, a) of the amounts."""
        size = np.linalg.norm(self.directions[0], axis=2)
        return np.asarray(np.where(size > 0, size / self.scale, np.inf))

    def trial(self, place: int) -> PointScore:
        """The score test at one of the points."""
        score, amounts = self.found
        return PointScore(float(score[place]), int(self.directions[1][place]), amounts[place], self.std[place])

    def noise_scores(self) -> Array:
        """The largest score over the grid in each noise draw, (NOISE_DRAWS,)."""
        null_model, whitened = self.null_model, self.whitened
        draws = null_model.cache.draws(null_model.fit.noise)
        raw = (
            self._summed(whitened.noise_inner_products(draws[null_model.index(whitened.choice)]))
            / self.scale[:, :, None]
        )
        if self._null_components.shape[2]:
            raw = raw - self._null_components @ null_model.draws_in_basis
        score, _ = self._scores(raw)
        return np.asarray(score.max(axis=0))

    def columns(self, place: int) -> Array:
        """The score columns (r, a) of one point."""
        blocks = self.whitened.columns[:, self._index[place]]
        return np.asarray(np.einsum("s,rsa->ra", self._weights[place], blocks))

    def test(self, place: int) -> PointTest:
        """The score tests at one of the points, in the noise where their scores come from."""
        score, known = self.trial(place), np.isfinite(self.scale[place])
        tested = ScoredColumns.of(self.null_model, self.columns(place), self.whitened.choice)
        free = tested.columns
        fitted = np.empty((len(free), 1 + free.shape[1]), order="F")
        fitted[:, 0], fitted[:, 1:] = free[:, known] @ score.amounts[known], free
        noise, *each = tested.noise_levels(fitted, free[:, known])
        power, variance = np.array([x.mean for x in each]), np.array([x.variance_of_log for x in each])
        alone = self._strongest_alone(place, tested, each) if score.rank > 1 else None
        return PointTest(score, noise, alone, power, variance)

    def _strongest_alone(self, place: int, tested: ScoredColumns, levels: Sequence[NoiseLevel]) -> AmplitudeTest:
        """Of a point's projected columns the one of the largest score relative to the noise, of these levels."""
        free = tested.columns
        length = np.sqrt(np.einsum("ra,ra->a", free, free))
        identifiable = length > RANK_TOLERANCE * self.scale[place]
        scores = (free.T @ tested.residual / np.where(identifiable, length, np.inf)) ** 2
        strongest = int(np.argmax(scores / np.array([level.mean for level in levels])))
        noise, column = levels[strongest], free[:, [strongest]]
        if not tested.spectrum_is_known:  # spectrum of the residual without this one column
            (noise,) = tested.noise_levels(column, column)
        return AmplitudeTest(float(scores[strongest]), noise, int(identifiable.sum()))
