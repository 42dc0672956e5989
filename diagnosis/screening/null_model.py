"""Null model of a score test: whitened residual of a fit and the subspace its own parameters span; and what score
tests in the same noise share."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import pairwise
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.progress import CountCallback, counted
from estimation.fit import Fit
from estimation.fit_column_space import (
    FitColumnSpace,
    RowIndex,
    fit_column_space,
    has_run_spectrum,
    rows_of_recordings,
)
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitened_spectrum import lines
from estimation.noise.whitening import Whitener

# Row sets of a whitened recording: excited lines, non-excited lines, all.


Array = NDArray[np.float64]


class RowSet(Enum):
    """Rows of one recording: none, the excited lines, the non-excited lines between them, or all."""

    NONE = "none"
    EXCITED = "excited lines"
    NON_EXCITED = "non-excited lines"
    WHOLE = "all"

    def within(self, whitener: Whitener) -> tuple[int, int]:
        """First row and the one after the last, within the recording."""
        ends = {
            RowSet.NONE: (0, 0),
            RowSet.EXCITED: (0, whitener.periodic_rows),
            RowSet.NON_EXCITED: (whitener.periodic_rows, whitener.rows),
            RowSet.WHOLE: (0, whitener.rows),
        }
        return ends[self]

    def whitened(self, whitener: Whitener, series: Array, *, periodic: bool) -> Array:
        """These rows (r, ...) of a whitened series (n, p, ...) over one repeat (periodic) or the whole record."""
        if self is RowSet.NONE:
            return np.zeros((0, *series.shape[2:]))
        if periodic:
            if self is RowSet.EXCITED:
                return whitener.steady_state(series)
            first, last = self.within(whitener)
            rows = np.zeros((last - first, *series.shape[2:]), order="F")
            if self is RowSet.WHOLE:
                rows[: whitener.periodic_rows] = whitener.steady_state(series)
            return rows
        if self is RowSet.NON_EXCITED:
            return whitener.non_excited(series)
        first, last = self.within(whitener)
        return whitener.series(series)[first:last]


RowChoice = tuple[RowSet, ...]
"""Row set of each recording of a fit."""
RowRanges = tuple[tuple[int, int], ...]
"""First row and the one after the last of each recording of a fit, counted within it."""


def row_ranges(choice: RowChoice, noise: Sequence[RecordingNoise]) -> RowRanges:
    """The chosen rows of each recording."""
    return tuple(rows.within(each.whitener) for rows, each in zip(choice, noise, strict=True))


def row_index(within: RowRanges, noise: Sequence[RecordingNoise]) -> RowIndex:
    """Indices of these rows of each recording among the concatenated rows of all."""
    ranges, start = [], 0
    for (first, last), each in zip(within, noise, strict=True):
        if last > first:
            ranges.append((start + first, start + last))
        start += each.whitener.rows
    if not ranges:
        return slice(0, 0)
    if all(end == begin for (_, end), (begin, _) in pairwise(ranges)):
        return slice(ranges[0][0], ranges[-1][1])
    return np.concatenate([np.arange(first, last) for first, last in ranges])


# White noise that score tests share: seeded, so that p-values are reproducible.


SingleArray = NDArray[np.float32]

NOISE_DRAWS = 100
NOISE_SEED = 0
"""Draws (and their seed) that give a search its effective number of tests."""
ROWS_AT_ONCE = 1000
"""Rows drawn together, few enough to be rounded while they are in the cache."""


@dataclass(eq=False)
class NoiseDraws:
    """Draws (rows, NOISE_DRAWS) of white noise of unit variance; the first rows are the same however many are drawn.

    In single precision: their quantiles are known to a part in ten, and their inner products take half the time.
    """

    _values: SingleArray = field(default_factory=lambda: np.zeros((0, NOISE_DRAWS), np.float32))

    def first(self, rows: int) -> SingleArray:
        """The first rows, drawn where they are not yet; not to be written to."""
        if rows > len(self._values):
            self._values = np.empty((rows, NOISE_DRAWS), np.float32)
            rng = np.random.default_rng(NOISE_SEED)
            for first in range(0, rows, ROWS_AT_ONCE):
                rows_drawn = self._values[first : first + ROWS_AT_ONCE]
                rows_drawn[:] = rng.standard_normal(rows_drawn.shape)
        return self._values[:rows]


# What score tests in the same noise share.


@dataclass(eq=False)
class WhitenedColumns:
    """Score columns (r, b, a) of an effect's a amplitudes at b building blocks, in the rows `choice`.

    Their inner products with each other and with the noise draws do not depend on the fit and are computed once.
    """

    columns: Array
    choice: RowChoice
    _noise_products: Array | None = field(default=None, init=False, repr=False)

    @property
    def bytes(self) -> int:
        """Memory of the columns; that of quantities computed from them is small in comparison."""
        return self.columns.nbytes

    @property
    def flat(self) -> Array:
        """The columns as a matrix, (r, a b): a view of columns in Fortran order."""
        return self.columns.reshape(len(self.columns), -1, order="F")

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
        return np.asarray(self.flat.T @ self.flat).reshape(a, b, a, b).transpose(1, 0, 3, 2)

    def of_blocks(self, index: NDArray[np.intp]) -> Array:
        """The columns (r, s, a) of some blocks."""
        return self.columns[:, index]

    def along_residual(self, null_model: NullModel) -> Array:
        """Inner products (b, a, 1) with the projected residual of a null model."""
        return self._inner_products(null_model.rows_of(self.choice)[0][:, None])

    def along_basis(self, null_model: NullModel) -> Array:
        """Inner products (b, a, k) with the basis of a null model's column space."""
        return self._inner_products(null_model.rows_of(self.choice)[1])

    def _inner_products(self, rows: Array) -> Array:
        _, b, a = self.columns.shape
        return np.asarray(self.flat.T @ rows).reshape(a, b, -1).swapaxes(0, 1)

    def noise_inner_products(self, draws: SingleArray) -> Array:
        """Inner products (b, a, NOISE_DRAWS) with noise draws (r, NOISE_DRAWS), the same in every call."""
        if self._noise_products is None:
            _, b, a = self.columns.shape
            products = self.flat.astype(draws.dtype).T @ draws
            self._noise_products = products.astype(np.float64).reshape(a, b, -1).swapaxes(0, 1)
        return self._noise_products


@dataclass(eq=False)
class BatchedColumns:
    """Score columns of more blocks than there is room for: inner products alone are held, of one batch after another.

    null_model  the residual, basis and noise draws that they are taken with
    evaluated   the columns (r, s, a) of some blocks, by their numbers
    at_once     blocks of a batch, of `blocks`
    drawn       whether products with the noise draws are wanted
    """

    null_model: NullModel
    evaluated: Callable[[NDArray[np.intp]], Array]
    choice: RowChoice
    blocks: int
    at_once: int
    drawn: bool = True

    @cached_property
    def _products(self) -> list[Array]:
        """With themselves, the residual, the basis and the draws; blocks first."""
        batches = np.split(np.arange(self.blocks), range(self.at_once, self.blocks, self.at_once))
        return [np.concatenate(products) for products in zip(*map(self._of_batch, batches), strict=True)]

    def _of_batch(self, numbers: NDArray[np.intp]) -> tuple[Array, ...]:
        batch, null_model = WhitenedColumns(self.evaluated(numbers), self.choice), self.null_model
        products = batch.block_gram, batch.along_residual(null_model), batch.along_basis(null_model)
        if not self.drawn:
            return products
        return *products, batch.noise_inner_products(null_model.draws[null_model.index(self.choice)])

    @property
    def block_gram(self) -> Array:
        """Inner products of each block's columns, (b, a, a)."""
        return self._products[0]

    @property
    def gram(self) -> NoReturn:
        """Not had: no sums of blocks are taken of so many."""
        raise NotImplementedError

    def of_blocks(self, index: NDArray[np.intp]) -> Array:
        """The columns (r, s, a) of some blocks, evaluated anew."""
        return self.evaluated(index)

    def along_residual(self, null_model: NullModel) -> Array:
        """Inner products (b, a, 1) with the projected residual of its null model."""
        assert null_model is self.null_model
        return self._products[1]

    def along_basis(self, null_model: NullModel) -> Array:
        """Inner products (b, a, k) with the basis of its null model's column space."""
        assert null_model is self.null_model
        return self._products[2]

    def noise_inner_products(self, draws: SingleArray) -> Array:
        """Inner products (b, a, NOISE_DRAWS) with the noise draws."""
        return self._products[3]


Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")

MAX_BYTES = 120e6
"""Memory (bytes) for cached whitened columns: those of the catalogue's grids in six axes and 8000 samples just fit."""
MAX_FITS = 4
"""Null models cached: those screened together, at most one for each effect of a set."""


@dataclass(eq=False)
class ScreeningCache:
    """Noise draws, whitened columns that do not depend on the fit, null models, and finished score tests.

    Its contents do not depend on the order of requests.
    """

    noise_draws: NoiseDraws = field(default_factory=NoiseDraws)
    _columns: OrderedDict[Hashable, WhitenedColumns] = field(default_factory=OrderedDict)
    _null_models: OrderedDict[Fit, NullModel] = field(default_factory=OrderedDict)
    _results: dict[Hashable, Any] = field(default_factory=dict)
    _drawn_motions: dict[Hashable, Any] = field(default_factory=dict)
    _motions: dict[Hashable, Any] = field(default_factory=dict)

    def forget(self) -> None:
        """Empty the cache but for the noise draws."""
        for kept in (self._columns, self._null_models, self._results, self._drawn_motions, self._motions):
            kept.clear()
        fit_column_space.cache_clear()

    def in_other_noise(self) -> ScreeningCache:
        """An empty cache for score tests in another noise, with the same noise draws and drawn motions."""
        return ScreeningCache(self.noise_draws, _motions=self._motions)

    def null_model(self, fit: Fit) -> NullModel:
        """The null model of a fit; the MAX_FITS used last are cached."""
        if fit not in self._null_models:
            self._null_models[fit] = NullModel(fit, self.noise_draws)
            while len(self._null_models) > MAX_FITS:
                self._null_models.popitem(last=False)
        self._null_models.move_to_end(fit)
        return self._null_models[fit]

    def drawn_motion(self, fit: Fit, make: Callable[[], Result]) -> Result:
        """What was drawn of the motion of a fit; that of the last fit is cached."""
        return _last_made(self._drawn_motions, fit, make)

    def motions(self, recordings: Hashable, make: Callable[[], Result]) -> Result:
        """Motions drawn for recordings, whatever is fitted to them; those drawn last are cached."""
        return _last_made(self._motions, recordings, make)

    def whitened(self, key: Hashable | None, make: Callable[[], WhitenedColumns]) -> WhitenedColumns:
        """Whitened columns by key; the least recently used are dropped beyond MAX_BYTES. None is not cached."""
        if key is None:
            return make()
        if key not in self._columns:
            whitened = make()
            if whitened.bytes > MAX_BYTES / 2:
                return whitened
            self._columns[key] = whitened
            while sum(w.bytes for w in self._columns.values()) > MAX_BYTES:
                self._columns.popitem(last=False)
        self._columns.move_to_end(key)
        return self._columns[key]

    def results(
        self, keys: Sequence[Key], make: Callable[[Key], Result], announce: CountCallback | None = None
    ) -> list[Result]:
        """The result of each key, computed once."""
        for key in counted([key for key in keys if key not in self._results], announce):
            self._results[key] = make(key)
        return [self._results[key] for key in keys]


def _last_made(kept: dict[Hashable, Any], key: Hashable, make: Callable[[], Result]) -> Result:
    """The result of a key, made unless it was the last one; only the last is kept."""
    if key not in kept:
        kept.clear()
        kept[key] = make()
    last: Result = kept[key]
    return last


@dataclass(eq=False)
class NullModel:
    """A fit as null model of score tests: its whitened residual and its column space.

    noise_draws  white noise, that of all score tests
    """

    fit: Fit
    noise_draws: NoiseDraws = field(default_factory=NoiseDraws)
    _rows: dict[RowChoice, tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def column_space(self) -> FitColumnSpace:
        """Whitened residual, and the column space of the fit's parameters in the rows where it is not zero."""
        return fit_column_space(self.fit)

    @property
    def whitened_residual(self) -> Array:
        """Whitened residual of the fit, (rows,)."""
        return self.column_space.residual

    @property
    def reached(self) -> RowIndex:
        """The rows in which the fit's parameters have non-zero derivatives."""
        return self.column_space.reached

    @property
    def directions(self) -> ColumnSpace:
        """Column space of the fit's whitened derivatives, in the reached rows."""
        return self.column_space.directions

    @cached_property
    def residual(self) -> Array:
        """Whitened residual (rows,) projected onto the complement of the column space."""
        return self.project_out(self.whitened_residual)

    @cached_property
    def cost(self) -> float:
        """Whitened chi-square of the fit."""
        return float(self.whitened_residual @ self.whitened_residual)

    def index(self, choice: RowChoice) -> RowIndex:
        """Indices of the chosen rows among all."""
        return row_index(row_ranges(choice, self.fit.noise), self.fit.noise)

    def rows_of(self, choice: RowChoice) -> tuple[Array, Array]:
        """Projected residual (r,) and orthonormal basis of the column space (r, k) in chosen rows of each recording."""
        if choice not in self._rows:
            index = self.index(choice)
            self._rows[choice] = self.residual[index], self.column_space.basis_in(index)
        return self._rows[choice]

    @property
    def draws(self) -> SingleArray:
        """White noise (rows, NOISE_DRAWS)."""
        return self.noise_draws.first(sum(n.whitener.rows for n in self.fit.noise))

    @cached_property
    def draws_in_basis(self) -> Array:
        """Components of the noise draws along the basis, (k, NOISE_DRAWS)."""
        draws = self.draws[self.reached]
        return (self.directions.basis.astype(draws.dtype).T @ draws).astype(np.float64)

    @cached_property
    def derivatives(self) -> list[list[tuple[Array, bool]]]:
        """Of each recording the summands (n, p, k) of the prediction's derivative, over one repeat (True) or all."""
        derivatives = []
        for number in range(len(self.fit.recordings)):
            response = self.fit.response(number)
            summands = [(response.periodic[1], True)]
            if response.whole is not None:
                whole = np.zeros((*response.whole[0].shape, summands[0][0].shape[2]))
                whole[:, :, slice(None) if response.columns is None else list(response.columns)] = response.whole[1]
                summands.append((whole, False))
            derivatives.append(summands)
        return derivatives

    def spread(self, columns: Array, choice: RowChoice) -> Array:
        """Columns (r, a) of the chosen rows, zero in all others, (rows, a)."""
        whole = np.zeros((len(self.residual), columns.shape[1]))
        whole[self.index(choice)] = columns
        return whole

    def project_out(self, whole: Array) -> Array:
        """Columns (rows, a) projected onto the complement of the column space."""
        free = whole.copy()
        basis, reached = self.directions.basis, self.reached
        inside = free[reached]
        free[reached] = inside - basis @ (basis.T @ inside)
        return free

    @cached_property
    def line_leverage(self) -> list[Array | None]:
        """Share (n, p) of each recording's lines that the column space takes; None where the spectrum is measured.

        That is with repeats, for static poses, and for a run too short to have one.
        """
        basis = self.column_space.basis_in(slice(0, len(self.residual)))
        leverages: list[Array | None] = []
        for recording, noise, rows in zip(
            self.fit.recordings, self.fit.noise, rows_of_recordings(self.fit), strict=True
        ):
            estimated = has_run_spectrum(recording, noise)
            taken = (lines(basis[rows], len(recording.channels)) ** 2).sum(axis=2) if estimated else None
            leverages.append(taken)
        return leverages

    @property
    def spectrum_is_known(self) -> bool:
        """Whether no recording's spectrum is that of its residual."""
        return all(leverage is None for leverage in self.line_leverage)

    @cached_property
    def reached_ends(self) -> list[int]:
        """How many rows of each recording are reached: its first ones."""
        mask = np.zeros(len(self.residual), dtype=bool)
        mask[self.reached] = True
        return [int(mask[rows].sum()) for rows in rows_of_recordings(self.fit)]
