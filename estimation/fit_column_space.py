"""Orthonormal basis of the whitened sensitivity columns, and the leverage of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.least_squares.square_root_information import ColumnSpace
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitened_spectrum import MIN_ROWS, WhitenedSpectrum, lines
from estimation.recordings.recording import Recording
from modeling.noise import NoiseSource

Array = NDArray[np.float64]
RowIndex = slice | NDArray[np.intp]
"""Some of the whitened rows."""


def rows_of_recordings(fit: Fit) -> list[slice]:
    """The whitened rows of each of a fit's recordings among those of all."""
    ends = np.cumsum([0, *(noise.whitener.rows for noise in fit.noise)]).tolist()
    return [slice(first, last) for first, last in pairwise(ends)]


@dataclass(frozen=True, eq=False)
class FitColumnSpace:
    """Whitened residual (rows,) of a fit, the rows `reached` by its sensitivities, and their column space there."""

    residual: Array
    reached: RowIndex
    directions: ColumnSpace

    @property
    def leverage(self) -> Array:
        """Leverage (rows,): diagonal of the hat matrix."""
        leverage = np.zeros(len(self.residual))
        leverage[self.reached] = np.einsum("ij,ij->i", self.directions.basis, self.directions.basis)
        return leverage

    def basis_in(self, index: RowIndex) -> Array:
        """The basis in other rows (r, k), with no columns where it is zero there."""
        basis, reached = self.directions.basis, self.reached
        if isinstance(index, slice) and isinstance(reached, slice):
            if index == reached:
                return basis
            if index.start >= reached.stop or index.stop <= reached.start:
                return np.zeros((index.stop - index.start, 0))
        whole = np.zeros((len(self.residual), basis.shape[1]))
        whole[reached] = basis
        return np.asarray(whole[index])


@lru_cache(maxsize=1)
def fit_column_space(fit: Fit) -> FitColumnSpace:
    """Column space of a fit, cached for the last one: its tests ask for it more than once.

    The derivative itself is not kept: it is as large as all the rest and not needed again.
    """
    linearised = fit.linearised()
    return FitColumnSpace(linearised.residual, linearised.reached, ColumnSpace.of(linearised.derivative))


# Spectrum of what whitening leaves of a single run's residual, by its fit.


def has_run_spectrum(recording: Recording, noise: RecordingNoise) -> bool:
    """Whether the spectrum is estimated: not with repeats, which measure it, of poses, and of too short a run."""
    rows = noise.whitener.rows // len(recording.channels)
    return noise.source is not NoiseSource.REPEATS and not recording.at_rest and rows >= MIN_ROWS


def run_spectrum(fit: Fit, number: int) -> WhitenedSpectrum | None:
    """Of the recording of that number, the fit's parameters projected out; None as `has_run_spectrum` has it."""
    recording, noise = fit.recordings[number], fit.noise[number]
    if not has_run_spectrum(recording, noise):
        return None
    space, p, rows = fit_column_space(fit), len(recording.channels), rows_of_recordings(fit)[number]
    taken = (lines(space.basis_in(rows), p) ** 2).sum(axis=2)
    return WhitenedSpectrum.of(space.residual[rows], taken)
