"""Null model of a score test: whitened residual of a fit and the subspace its own parameters span."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.row_selection import RowChoice, row_index, row_ranges
from diagnosis.screening.screening_cache import ScreeningCache
from estimation.fit import Fit
from estimation.fit_column_space import FitColumnSpace, RowIndex, fit_column_space
from estimation.least_squares.column_space import ColumnSpace
from estimation.noise.whitened_spectrum import lines
from estimation.run_spectrum import has_run_spectrum
from modeling.chain.effect import SearchDomain

Array = NDArray[np.float64]


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
