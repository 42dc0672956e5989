"""Projection of score columns onto the complement of the null model; score statistics and estimated amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import NullModel
from diagnosis.screening.point_test import AmplitudeTest, PointScore, PointTest
from diagnosis.screening.row_selection import RowChoice
from diagnosis.screening.scored_columns import ScoredColumns
from estimation.least_squares.levenberg_marquardt import NEGLIGIBLE_COLUMN_LENGTH
from estimation.noise.noise_level import NoiseLevel
from modeling.chain.effect import GridSuperposition

Array = NDArray[np.float64]
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
