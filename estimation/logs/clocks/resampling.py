"""Resampling of series at other instants: cubic for smooth series, spherical linear or cubic for orientation."""

from __future__ import annotations

import numpy as np

from estimation.logs.log_table import Array


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
