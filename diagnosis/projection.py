"""Projection: what an effect would bring beside all that a model can do already, from inner products of its columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.rows import Choice
from estimation.linear.descent import FAINT
from modeling.effect import Combination

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-4
"""Share of a column that must be left after projection; less is a derivative's rounding, not a direction."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What the columns of an effect's amplitudes would bring at one nuisance value.

    score   drop of the whitened chi-square, with `rank` degrees of freedom
    amounts, std  per amplitude, (a,), in its unit
    """

    score: float
    rank: int
    amounts: Array
    std: Array


@dataclass(frozen=True, eq=False)
class Whitened:
    """Whitened columns (r, b, a) of an effect's a amplitudes at b building blocks, in the rows `choice`.

    Their inner products with each other and with draws of noise are computed once: no fit changes them.
    """

    columns: Array
    choice: Choice

    @property
    def bytes(self) -> int:
        """Memory of the columns; what is computed from them is small beside it where there are many rows."""
        return self.columns.nbytes

    @cached_property
    def flat(self) -> Array:
        """Columns side by side, (r, b a)."""
        return self.columns.reshape(len(self.columns), -1)

    @cached_property
    def own_gram(self) -> Array:
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

    def along(self, rows: Array) -> Array:
        """Inner products (b, a, m) with other columns (r, m) of the same rows."""
        _, b, a = self.columns.shape
        return np.asarray(self.flat.T @ rows).reshape(b, a, rows.shape[1])

    def drawn(self, draws: Array) -> Array:
        """Inner products (b, a, DRAWS) with draws of noise (r, DRAWS) in these rows, computed once."""
        if "products" not in self._drawn:
            self._drawn["products"] = self.along(draws)
        return self._drawn["products"]

    @cached_property
    def _drawn(self) -> dict[str, Array]:
        return {}


@dataclass(frozen=True, eq=False)
class Projected:
    """An effect at the points of its search domain, less what the model does already.

    The columns of a point are sums of building blocks' (`combination`), so that their inner products are sums of those.
    Each group is scaled to columns of unit length and brought to its principal directions, of which those with less
    than RANK_TOLERANCE left are no directions. `low` bounds a single amplitude from below.
    """

    background: Background
    whitened: Whitened
    combination: Combination
    low: float

    @cached_property
    def _index(self) -> NDArray[np.intp]:
        return np.array(self.combination.index, dtype=np.intp)

    @cached_property
    def _weights(self) -> Array:
        return np.array(self.combination.weights)

    def _summed(self, blocks: Array) -> Array:
        """Quantities (b, ...) of the blocks, linear in their columns, at the points, (g, ...)."""
        if self._index.shape[1] == 1 and len(self._index) == len(blocks):
            return blocks  # every point is its own block
        return np.asarray(np.einsum("gs,gs...->g...", self._weights, blocks[self._index]))

    @cached_property
    def gram(self) -> Array:
        """Inner products (g, a, a) of the points' columns."""
        if self._index.shape[1] == 1:
            return self._summed(self.whitened.own_gram)
        pairs = self.whitened.gram[self._index[:, :, None], :, self._index[:, None, :], :]
        return np.asarray(np.einsum("gs,gt,gstab->gab", self._weights, self._weights, pairs))

    @cached_property
    def scale(self) -> Array:
        """Length of each column, (g, a); without end where it is rounding only, so that nothing is made of it."""
        length = np.sqrt(np.maximum(np.diagonal(self.gram, axis1=1, axis2=2), 0.0))
        return np.asarray(np.where(length > FAINT, length, np.inf))

    @cached_property
    def _taken(self) -> Array:
        """Parts (g, a, k) of unit columns along the fit's own directions."""
        taken = self.background.taken(self.whitened.choice)
        return self._summed(self.whitened.along(taken.basis)) / self.scale[:, :, None]

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Inverse roots (g, a, a) that make the free columns orthonormal, zero where there is none; ranks (g,)."""
        unit = self.gram / self.scale[:, :, None] / self.scale[:, None, :]
        free = unit - self._taken @ self._taken.swapaxes(1, 2)
        if free.shape[1] == 1:
            values, vectors = free[:, :, 0], np.ones_like(free)
        else:
            values, vectors = np.linalg.eigh(free)
        kept = values > RANK_TOLERANCE**2
        inverse = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return vectors * inverse[:, None, :], kept.sum(axis=1)

    def _scores(self, product: Array) -> tuple[Array, Array]:
        """Chi-square drop (g, m) and amounts (g, a, m) from unit columns' products (g, a, m) with free residuals."""
        roots, _ = self.directions
        along = roots.swapaxes(1, 2) @ product
        amounts = (roots @ along) / self.scale[:, :, None]
        score = (along**2).sum(axis=1)
        if np.isfinite(self.low):
            score = np.where(amounts[:, 0] > self.low, score, 0.0)
        return score, amounts

    @cached_property
    def found(self) -> tuple[Array, Array]:
        """Chi-square drop (g,) and amounts (g, a) that the residual gives."""
        residual = self.background.taken(self.whitened.choice).residual
        product = self._summed(self.whitened.along(residual[:, None])) / self.scale[:, :, None]
        score, amounts = self._scores(product)
        return score[:, 0], amounts[:, :, 0]

    @cached_property
    def std(self) -> Array:
        """Standard deviations (g, a) of the amounts."""
        size = np.linalg.norm(self.directions[0], axis=2)
        return np.asarray(np.where(size > 0, size / self.scale, np.inf))

    def trial(self, place: int) -> Trial:
        """One of the points."""
        score, amounts = self.found
        return Trial(float(score[place]), int(self.directions[1][place]), amounts[place], self.std[place])

    def noise_scores(self) -> Array:
        """The largest score of these columns in draws of pure noise, (DRAWS,)."""
        background, whitened = self.background, self.whitened
        draws = background.workspace.draws(background.fit.noise)
        raw = self._summed(whitened.drawn(draws[background.index(whitened.choice)])) / self.scale[:, :, None]
        if self._taken.shape[2]:
            raw = raw - self._taken @ background.drawn
        score, _ = self._scores(raw)
        return np.asarray(score.max(axis=0))

    def columns(self, place: int) -> Array:
        """The columns (r, a) of one point."""
        blocks = self.whitened.columns[:, self._index[place]]
        return np.asarray(np.einsum("s,rsa->ra", self._weights[place], blocks))

    def doubt(self, place: int) -> float:
        """Variance of the logarithm of the noise's power where a point's score comes from."""
        _, amounts = self.found
        scale = self.scale[place]
        known = np.isfinite(scale)
        fitted = self.columns(place)[:, known] @ amounts[place, known]
        free = self.background.freed(self.background.spread(fitted[:, None], self.whitened.choice))
        return float(self.background.doubt_of(free)[0])
