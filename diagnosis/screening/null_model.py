"""Null model of a score test: whitened residual of a fit and the subspace its own parameters span."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.progress import CountCallback, counted
from estimation.fit import Fit
from estimation.fit_column_space import FitColumnSpace, RowIndex, fit_column_space, has_run_spectrum
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitened_spectrum import lines
from estimation.noise.whitening import Whitener
from modeling.chain.effect import SearchDomain

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
            found = np.zeros((last - first, *series.shape[2:]), order="F")
            if self is RowSet.WHOLE:
                found[: whitener.periodic_rows] = whitener.steady_state(series)
            return found
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
    return tuple(rows.within(own.whitener) for rows, own in zip(choice, noise, strict=True))


def row_index(within: RowRanges, noise: Sequence[RecordingNoise]) -> RowIndex:
    """Indices of these rows of each recording among the concatenated rows of all."""
    ranges, start = [], 0
    for (first, last), own in zip(within, noise, strict=True):
        if last > first:
            ranges.append((start + first, start + last))
        start += own.whitener.rows
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
                part = self._values[first : first + ROWS_AT_ONCE]
                part[:] = rng.standard_normal(part.shape)
        return self._values[:rows]

    def forget(self) -> None:
        """Release the memory."""
        self._values = np.zeros((0, NOISE_DRAWS), np.float32)


# Cache shared by score tests in the same noise: noise draws, whitened sensitivities, search results.


Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


class SizedColumns(Protocol):
    """An object that knows its size in memory."""

    @property
    def bytes(self) -> int: ...


Columns = TypeVar("Columns", bound=SizedColumns)

MAX_BYTES = 120e6
"""Memory (bytes) for cached whitened sensitivities."""
MAX_FITS = 4
"""Null models cached: those screened together, at most one for each effect of a set."""


@dataclass(frozen=True, eq=False)
class ScreeningCache:
    """Noise draws, whitened sensitivities that do not depend on the fit, null models, and finished searches.

    Its contents do not depend on the order of requests.
    """

    noise_draws: NoiseDraws = field(default_factory=NoiseDraws)
    _sensitivities: OrderedDict[Hashable, Any] = field(default_factory=OrderedDict)
    _null_models: OrderedDict[Hashable, Any] = field(default_factory=OrderedDict)
    _found: dict[Hashable, object] = field(default_factory=dict)
    _drawn_motions: dict[Hashable, Any] = field(default_factory=dict)
    _motions: dict[Hashable, Any] = field(default_factory=dict)

    def forget(self) -> None:
        """Empty the cache but for the noise draws: null models and their cache refer to each other, and are large."""
        for cache in (self._sensitivities, self._null_models, self._found, self._drawn_motions, self._motions):
            cache.clear()
        fit_column_space.cache_clear()

    def in_other_noise(self) -> ScreeningCache:
        """An empty cache for score tests in another noise, with the same noise draws and drawn motions."""
        return ScreeningCache(self.noise_draws, _motions=self._motions)

    def null_model(self, fit: Hashable, make: Callable[[], Result]) -> Result:
        """The null model of a fit; the MAX_FITS used last are cached."""
        if fit not in self._null_models:
            self._null_models[fit] = make()
            while len(self._null_models) > MAX_FITS:
                self._null_models.popitem(last=False)
        self._null_models.move_to_end(fit)
        found: Result = self._null_models[fit]
        return found

    def drawn_motion(self, fit: Hashable, make: Callable[[], Result]) -> Result:
        """What was drawn of the motion of a fit; that of the last fit is cached."""
        return _last_made(self._drawn_motions, fit, make)

    def motions(self, recordings: Hashable, make: Callable[[], Result]) -> Result:
        """Motions drawn for recordings, whatever is fitted to them; those drawn last are cached."""
        return _last_made(self._motions, recordings, make)

    def draws(self, noise: Sequence[RecordingNoise]) -> NDArray[np.float32]:
        """White noise (rows, NOISE_DRAWS) over all rows."""
        return self.noise_draws.first(sum(n.whitener.rows for n in noise))

    def whitened(self, key: Hashable | None, make: Callable[[], Columns]) -> Columns:
        """Whitened sensitivities by key; the least recently used are dropped beyond MAX_BYTES. None is not cached."""
        if key is None:
            return make()
        if key not in self._sensitivities:
            made = make()
            if made.bytes > MAX_BYTES / 2:
                return made
            self._sensitivities[key] = made
            while sum(w.bytes for w in self._sensitivities.values()) > MAX_BYTES:
                self._sensitivities.popitem(last=False)
        self._sensitivities.move_to_end(key)
        found: Columns = self._sensitivities[key]
        return found

    def results(
        self, keys: Sequence[Key], make: Callable[[Key], Result], announce: CountCallback | None = None
    ) -> list[Result]:
        """The result of each key, computed once."""
        for key in counted([key for key in keys if key not in self._found], announce):
            self._found[key] = make(key)
        return [self._found[key] for key in keys]  # type: ignore[misc]


def _last_made(kept: dict[Hashable, Any], key: Hashable, make: Callable[[], Result]) -> Result:
    """The result of a key, made unless it was the last one; only the last is kept."""
    if key not in kept:
        kept.clear()
        kept[key] = make()
    found: Result = kept[key]
    return found


@dataclass(frozen=True, eq=False)
class NullRows:
    """Some rows of a null model: projected residual (r,) and orthonormal basis of its column space (r, k)."""

    residual: Array
    basis: Array


@dataclass(frozen=True, eq=False)
class NullModel:
    """A fit as null model of a score test: its whitened residual and its column space.

    cache  cache shared by all fits to these recordings in this noise
    """

    fit: Fit
    cache: ScreeningCache = field(default_factory=ScreeningCache)

    @classmethod
    def of(cls, fit: Fit, cache: ScreeningCache) -> NullModel:
        """The null model of a fit, cached."""
        return cache.null_model(fit, lambda: cls(fit, cache))

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

    @cached_property
    def _null_rows(self) -> dict[RowChoice, NullRows]:
        return {}

    def index(self, choice: RowChoice) -> RowIndex:
        """Indices of the chosen rows among all."""
        return row_index(row_ranges(choice, self.fit.noise), self.fit.noise)

    def rows_of(self, choice: RowChoice) -> NullRows:
        """Projected residual and basis in chosen rows of each recording."""
        if choice not in self._null_rows:
            index = self.index(choice)
            self._null_rows[choice] = NullRows(self.residual[index], self.column_space.basis_in(index))
        return self._null_rows[choice]

    @cached_property
    def draws_in_basis(self) -> Array:
        """Components of the noise draws along the basis, (k, NOISE_DRAWS)."""
        draws = self.cache.draws(self.fit.noise)[self.reached]
        return (self.directions.basis.astype(draws.dtype).T @ draws).astype(np.float64)

    def search_domain(self, number: int, make: Callable[[], SearchDomain]) -> SearchDomain:
        """Search domain of a recording for new effects, computed once."""
        if number not in self._search_domains:
            self._search_domains[number] = make()
        return self._search_domains[number]

    @cached_property
    def _search_domains(self) -> dict[int, SearchDomain]:
        return {}

    def derivatives(self, number: int) -> list[tuple[Array, bool]]:
        """Summands (n, p, k) of the prediction's derivative, over one repeat (True) or the whole record (False)."""
        return self._derivatives[number]

    @cached_property
    def _derivatives(self) -> list[list[tuple[Array, bool]]]:
        found = []
        for number in range(len(self.fit.recordings)):
            response = self.fit.response(number)
            parts = [(response.periodic[1], True)]
            if response.whole is not None:
                whole = np.zeros((*response.whole[0].shape, parts[0][0].shape[2]))
                whole[:, :, slice(None) if response.columns is None else list(response.columns)] = response.whole[1]
                parts.append((whole, False))
            found.append(parts)
        return found

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
        found: list[Array | None] = []
        for recording, noise, part in zip(self.fit.recordings, self.fit.noise, self._parts, strict=True):
            p = len(recording.channels)
            known = has_run_spectrum(recording, noise)
            found.append((lines(basis[part], p) ** 2).sum(axis=2) if known else None)
        return found

    @cached_property
    def reached_ends(self) -> list[int]:
        """How many rows of each recording are reached: its first ones."""
        mask = np.zeros(len(self.residual), dtype=bool)
        mask[self.reached] = True
        return [int(mask[part].sum()) for part in self._parts]

    @property
    def _parts(self) -> list[slice]:
        """The rows of each recording."""
        ends = np.cumsum([0, *(n.whitener.rows for n in self.fit.noise)])
        return [slice(int(first), int(last)) for first, last in pairwise(ends)]
