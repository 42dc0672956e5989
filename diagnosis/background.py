"""Background: a fit as a new effect sees it, with what is left and the directions that are taken already."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.rows import Choice, Index, index_of
from diagnosis.workspace import Workspace
from estimation.directions import Directions, Spanned, spanned
from estimation.fit import Fit
from modeling.effect import Extent

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Taken:
    """What a background says of some rows: the residual there (r,), and the fit's own directions (r, k)."""

    residual: Array
    basis: Array


@dataclass(frozen=True, eq=False)
class Background:
    """A fit as seen by a new column: what is left, and the directions that are taken already.

    workspace   what all fits to these recordings in this noise share
    """

    fit: Fit
    workspace: Workspace = field(default_factory=Workspace)

    @classmethod
    def of(cls, fit: Fit, workspace: Workspace) -> Background:
        """The fit's background in a workspace, the same one when asked again."""
        return workspace.recent(fit, lambda: cls(fit, workspace))

    def prepare(self) -> None:
        """Compute what every effect's screening needs, before it is shared out."""
        self.workspace.draws(self.fit.noise)
        _ = self.drawn, self.residual

    @cached_property
    def spanned(self) -> Spanned:
        """Whitened residual, the rows that the fit's own parameters reach, and what they do there."""
        return spanned(self.fit)

    @property
    def raw_residual(self) -> Array:
        """Whitened residual of the fit, (rows,)."""
        return self.spanned.residual

    @property
    def reached(self) -> Index:
        """The rows that the fit's own parameters reach."""
        return self.spanned.reached

    @property
    def directions(self) -> Directions:
        """What the fit's own parameters do, in the rows that they reach."""
        return self.spanned.directions

    @cached_property
    def residual(self) -> Array:
        """Whitened residual (rows,) with those directions taken out."""
        free = self.raw_residual.copy()
        basis, reached = self.directions.basis, self.reached
        own = free[reached]
        free[reached] = own - basis @ (basis.T @ own)
        return free

    @cached_property
    def cost(self) -> float:
        """Whitened chi-square of the fit."""
        return float(self.raw_residual @ self.raw_residual)

    @cached_property
    def _taken(self) -> dict[Choice, Taken]:
        return {}

    def index(self, choice: Choice) -> Index:
        """Where chosen rows stand among all."""
        return index_of(choice, self.fit.noise)

    def taken(self, choice: Choice) -> Taken:
        """Residual and directions in some rows of each recording."""
        if choice not in self._taken:
            index = self.index(choice)
            self._taken[choice] = Taken(self.residual[index], self._basis_in(index))
        return self._taken[choice]

    def _basis_in(self, index: Index) -> Array:
        """The basis of the fit's directions in other rows (r, k), without columns where nothing of it is there."""
        basis, reached = self.directions.basis, self.reached
        if isinstance(index, slice) and isinstance(reached, slice):
            if index == reached:
                return basis
            if index.start >= reached.stop or index.stop <= reached.start:
                return np.zeros((index.stop - index.start, 0))
        whole = np.zeros((len(self.residual), basis.shape[1]))
        whole[reached] = basis
        return np.asarray(whole[index])

    @cached_property
    def drawn(self) -> Array:
        """Pure noise along the fit's directions, (k, DRAWS)."""
        return np.asarray(self.directions.basis.T @ self.workspace.draws(self.fit.noise)[self.reached])

    def extent(self, number: int, make: Callable[[], Extent]) -> Extent:
        """What a recording spans for new effects, made when first asked for."""
        if number not in self._extents:
            self._extents[number] = make()
        return self._extents[number]

    @cached_property
    def _extents(self) -> dict[int, Extent]:
        return {}

    def derivatives(self, number: int) -> list[tuple[Array, bool]]:
        """Summands (n, p, k) of a predicted derivative, each one repeat (True) or the whole record (False)."""
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

    def spread(self, columns: Array, choice: Choice) -> Array:
        """Columns (r, a) of the chosen rows in all rows (rows, a)."""
        whole = np.zeros((len(self.residual), columns.shape[1]))
        whole[self.index(choice)] = columns
        return whole

    def freed(self, whole: Array) -> Array:
        """Columns (rows, a) less their part in the fit's directions."""
        free = whole.copy()
        basis, reached = self.directions.basis, self.reached
        own = free[reached]
        free[reached] = own - basis @ (basis.T @ own)
        return free

    def doubt_of(self, fitted: Array) -> Array:
        """Doubt (g,) of the chi-square that each column of fitted rows (rows, g) takes away, by where it comes from."""
        shares = fitted**2 / np.maximum((fitted**2).sum(axis=0), 1e-300)
        parts = np.split(shares, np.cumsum([n.whitener.rows for n in self.fit.noise])[:-1])
        return np.asarray(sum(n.doubt_of(part) for n, part in zip(self.fit.noise, parts, strict=True)))
