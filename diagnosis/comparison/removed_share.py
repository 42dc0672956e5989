"""Of what single runs' residuals hold beyond noise, what a larger model removes and what remains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.residual_spectrum import ResidualSpectrum
from estimation.noise.recording_noise import NoiseSource


def removed_share(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """Of the power that the residuals had, beyond noise, the share that a larger model removed.

    `before` and `after` are comparisons of the smaller and of the larger model with the same recordings. One where
    nothing remains, as where no noise is taken from the residual of a run.
    """
    removed, remains = removed_power(before, after), remaining_power(after)
    return removed / max(removed + remains, 1e-300) if remains else 1.0


def removed_power(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """Fall of the residuals' mean squares, over the variance of the noise, summed over channels and single runs."""
    total = 0.0
    for number, spectrum in _spectra(after):
        squares = [(c.residual**2).mean(axis=0) for c in (before[number], after[number])]
        total += float((np.maximum(squares[0] - squares[1], 0.0) / spectrum.noise_variance).sum())
    return total


def remaining_power(comparisons: Sequence[Comparison]) -> float:
    """In the band of the motion, beyond noise that rises as 1/f, in the same unit."""
    return sum(float((s.beyond_flicker_noise / s.noise_variance).sum()) for _, s in _spectra(comparisons))


def _spectra(comparisons: Sequence[Comparison]) -> Iterator[tuple[int, ResidualSpectrum]]:
    """Index and residual spectrum of each single run whose noise is taken from its residual."""
    for number, c in enumerate(comparisons):
        if c.noise.source is NoiseSource.RESIDUAL and not c.recording.at_rest:
            yield number, ResidualSpectrum.of(c.residual, c.recording.wrench - c.residual)
