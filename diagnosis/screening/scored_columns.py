"""Columns of a score test in the rows that they reach, and the level of the noise there."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import NullModel
from diagnosis.screening.row_selection import RowChoice, RowRanges, row_index, row_ranges
from estimation.least_squares.column_space import ColumnSpace
from estimation.noise.noise_level import NoiseLevel
from estimation.noise.recording_noise import NoiseSource
from estimation.noise.whitened_spectrum import WhitenedSpectrum, lines

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
