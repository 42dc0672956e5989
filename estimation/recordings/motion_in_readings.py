"""Whether the readings of repeats contain what differences of their motion add to them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from modeling.significance import LEVELS

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

SPECTRUM_BANDS = 40
"""Of a spectrum that weighs what differs between repeats, equally wide in the logarithm of the frequency."""
FEWEST_LINES = 4
"""Of a band: the power of a single line may by chance be ten times too low."""
ROUNDING = 1e-10
"""Relative size below which a channel's variation, a variance or a line's power is only rounding."""


def varying_channels(readings: Array) -> NDArray[np.bool_]:
    """Which channels (p,) of readings (n, p) are not constant."""
    return np.asarray(readings.std(axis=0) > ROUNDING * np.abs(readings).max(axis=0))


def is_separated(added: Array, readings: Array, repeats: int) -> bool:
    """Whether differences between repeats of the readings (n, p) surely contain what the motion adds to them (n, p).

    Repeats are compared by orthonormal contrasts of the samples of one phase, of which stationary noise makes runs of
    its own colour, and the mean nothing. An autoregression of these runs whitens them without leakage from their ends,
    and the channels are made uncorrelated by the innovations' covariance; constant channels say nothing, and neither
    does the mean of a run, as the sensor's zero may differ.

    In a band of m lines with the noise power S, unknown, the lines E are normal about zero if the motion was not so,
    and about the lines D of what it adds if it was. With the prior dS / S (right Haar) the likelihoods of the two are
    as (sum |E - D|²)^-m to (sum |E|²)^-m; above 99 to 1 over all bands and channels the second is taken. Whatever D
    is, such a ratio has the mean 1 where E is noise, so that it exceeds 99 at one time in 99 at the most (an e-value;
    P. Grünwald, R. de Heide and W. Koolen, J. R. Stat. Soc. B 86, 2024, 1091-1128).
    """
    varying = varying_channels(readings)
    if not varying.any():
        return False
    found, expected = (_contrasts(series[:, varying], repeats) for series in (readings, added))
    noise = fit_autoregression(found.transpose(0, 2, 1).reshape(-1, found.shape[1]), _with_past(found))
    found, expected = (noise.innovations(runs).transpose(0, 2, 1) for runs in (found, expected))
    decorrelated = _decorrelation(found.reshape(-1, found.shape[2]))
    lines, moved = (_lines(runs @ decorrelated) for runs in (found, expected))
    return 2 * sum(_evidence(lines[:, b], moved[:, b]) for b in _bands(lines.shape[1])) > LEVELS.separated_by_readings


def _contrasts(series: Array, repeats: int) -> Array:
    """Contrasts (R - 1, p, N) of the repeats of a series (n, p)."""
    runs = series.reshape(repeats, -1, series.shape[1])
    return np.asarray(np.einsum("cr,rnp->cpn", scipy.linalg.helmert(repeats), runs))


def _with_past(runs: Array) -> NDArray[np.bool_]:
    """Which samples (c N,) of runs (c, p, N) have one before them in their own run."""
    free = np.ones((runs.shape[0], runs.shape[2]), dtype=bool)
    free[1:, 0] = False
    return free.ravel()


def _lines(runs: Array) -> Spectrum:
    """Complex lines (c, m, q) of runs (c, n, q): neither that of their mean nor, of an even number, the highest."""
    return np.asarray(np.fft.rfft(runs, axis=1)[:, 1 : (runs.shape[1] + 1) // 2])


def _evidence(lines: Spectrum, moved: Spectrum) -> float:
    """Logarithm of the ratio of likelihoods of lines (c, m, q) of one noise power: with those of the motion, without.

    Of a power that is only rounding the ratio is limited.
    """
    count = lines.shape[0] * lines.shape[1]
    power, left = (np.sum(np.abs(part) ** 2, axis=(0, 1)) for part in (lines, lines - moved))
    seen = power > 0
    return float(count * np.log(power[seen] / np.maximum(left[seen], ROUNDING * power[seen])).sum())


def _bands(lines: int) -> list[slice]:
    """Bands of a spectrum's lines, none of fewer than `FEWEST_LINES` if there are as many."""
    edges = [0]
    for edge in (np.geomspace(1, lines + 1, SPECTRUM_BANDS + 1) - 1).astype(int):
        if edge - edges[-1] >= FEWEST_LINES:
            edges.append(int(edge))
    return [slice(a, b) for a, b in pairwise([*(edges[:-1] or [0]), lines])]


def _decorrelation(series: Array) -> Array:
    """Matrix (p, q) that makes a series (n, p) of zero mean uncorrelated and of unit variance, q <= p."""
    size = np.sqrt((series**2).mean(axis=0))
    seen = size > 0
    scale = np.diag(1 / np.where(seen, size, 1.0))[:, seen]
    unit = series @ scale
    variances, vectors = np.linalg.eigh(unit.T @ unit / len(unit))
    regular = variances > ROUNDING
    return np.asarray(scale @ vectors[:, regular] / np.sqrt(variances[regular]))
