"""Resampling of series at other instants: cubic for smooth series, spherical linear or cubic for orientation,
band-limited for readings with noise."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from estimation.logs.log_table import Array

REACH = 64
"""Samples to either side that a band-limited interpolation uses."""
KAISER = 8.0
"""Shape of its Kaiser window: with this reach it passes 96 % of the band, and rejects images by 80 dB and more."""
FRACTIONS = 2048
"""Positions between two samples for which weights are tabulated; between them they are linear, to 1e-7."""
ROWS_AT_ONCE = 4096


def band_limited(values: Array, places: Array) -> Array:
    """Series (n, k) at places (m,), in samples, by a sinc under a Kaiser window.

    Noise keeps its spectrum, white noise stays white with the same variance: linear or cubic interpolation would take
    up to half of its upper frequencies away, at some places more than at others. Beyond its ends the series is
    continued by odd reflection.
    """
    reach = min(REACH, len(values) - 1)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    windows = sliding_window_view(padded, 2 * reach, axis=0)
    table = _weights(reach)
    found = np.empty((len(places), values.shape[1]))
    for start in range(0, len(places), ROWS_AT_ONCE):
        inside = np.clip(places[start : start + ROWS_AT_ONCE], 0, len(values) - 1)
        base = np.floor(inside).astype(np.intp)
        fraction = (inside - base) * FRACTIONS
        row = np.minimum(fraction.astype(np.intp), FRACTIONS - 1)
        share = (fraction - row)[:, None]
        weights = table[row] * (1 - share) + table[row + 1] * share
        found[start : start + ROWS_AT_ONCE] = np.einsum("mkj,mj->mk", windows[base + 1], weights)
    return found


def _weights(reach: int) -> Array:
    """Weights (fractions + 1, 2 reach) of the samples 1 - reach .. reach about a place, of sum one."""
    distance = np.linspace(0, 1, FRACTIONS + 1)[:, None] - np.arange(1 - reach, reach + 1)
    window = np.i0(KAISER * np.sqrt(np.maximum(1 - (distance / reach) ** 2, 0.0)))
    weights = np.sinc(distance) * window
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def interpolated_position(stamps: Array, values: Array, instants: Array) -> Array:
    """Cubic spline (not-a-knot) through smooth values (n, k) at increasing stamps (n,), at the instants (m,).

    A sampled motion has its power far below half the sampling rate, where a cubic spline is band-limited interpolation
    to (f dt)^4. Outside the stamps the end values hold.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    inside = np.clip(instants, stamps[0], stamps[-1])
    if len(stamps) < 4:
        return np.stack([np.interp(inside, stamps, column) for column in values.T], axis=1)
    return np.asarray(CubicSpline(stamps, values)(inside))


def interpolated_quaternion(stamps: Array, quaternions: Array, instants: Array) -> Array:
    """Orientations (m, 4) at the instants, from unit quaternions (n, 4), x y z w, at increasing stamps (n,).

    Slerp between the neighbours, plus what a cubic spline of the rotation vector relative to slerp's chord adds is, for
    small steps, a cubic spline of the sign-continuous components, normalised: its error is of order (omega dt)^4, that
    of slerp (alpha dt²)/8. Steps of more than 0.3 rad, where components bend, are taken by slerp.
    """
    from scipy.spatial.transform import Rotation, Slerp  # slow to import

    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    cosine = np.sum(unit[1:] * unit[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(cosine < 0, -1.0, 1.0)]))
    unit = unit * signs[:, None]
    inside = np.clip(instants, stamps[0], stamps[-1])
    if len(stamps) < 4 or 2 * np.arccos(np.clip(np.abs(cosine).min(), 0, 1)) > 0.3:
        return np.asarray(Slerp(stamps, Rotation.from_quat(unit))(inside).as_quat())
    found = interpolated_position(stamps, unit, inside)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))
