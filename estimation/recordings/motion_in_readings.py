"""Whether the readings of repeats contain what differences of their motion add to them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.repeat_motion import difference_of
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

    The channels are made uncorrelated by the covariance of the differences, and whitened by their correlation from
    sample to sample, so that slow ones do not leak into other lines; constant channels say nothing. Lines at multiples
    of the repeats' number are those of the mean, which the differences do not have.
    """
    varying = varying_channels(readings)
    if not varying.any():
        return False
    differences, added = (difference_of(series[:, varying], repeats) for series in (readings, added))
    decorrelated = _decorrelation(differences)
    differences, added = differences @ decorrelated, added @ decorrelated
    correlation = (differences[1:] * differences[:-1]).mean(axis=0)
    kept = np.arange((len(added) - 1) // 2 + 1) % repeats > 0
    expected, found = (np.fft.rfft(s[1:] - correlation * s[:-1], axis=0)[kept] for s in (added, differences))
    weight = 1 / _spectrum(found)
    agreement = float((np.real(expected.conj() * found) * weight).sum())
    return 4 * agreement - 2 * float((np.abs(expected) ** 2 * weight).sum()) > LEVELS.separated_by_readings


def _spectrum(lines: Spectrum) -> Array:
    """Power (m, p) of noise with these lines (m, p), the mean of each band."""
    power = np.abs(lines) ** 2
    means = [np.broadcast_to(power[b].mean(axis=0), power[b].shape) for b in _bands(len(power))]
    return np.asarray(np.maximum(np.concatenate(means), ROUNDING * power.max(initial=np.finfo(float).tiny)))


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
