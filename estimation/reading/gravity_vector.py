"""Gravity vector: orientation from gravity or an accelerometer in the sensor's axes, where no pose was logged.

A rigid tool's wrench follows the specific force a - g, the angular velocity and the angular acceleration, all in the
sensor's axes, so that the turn about the vertical does not matter: it is carried on from row to row by the smallest
turn. Of poses at rest gravity is all that acts. In a motion an accelerometer at the sensor measures a - g itself: its
direction is taken as the world's up, and what its length is beyond g as an acceleration along it, so that
R'(a - g) is what was measured; a gyroscope beside it gives the angular velocity.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimation.reading.log_reader import Array
from estimation.recordings.motion import QUATERNION
from modeling.errors import InputError
from modeling.rig import STANDARD_GRAVITY

RATES, ACCELERATION = ("wx", "wy", "wz"), ("apx", "apy", "apz")
GRAVITY_TOLERANCE = 0.25
"""Share by which the median length of a vector may differ from g in its unit: a motion of 0.7 g rms adds as much, and
the next unit is ten times as large."""
LENGTHS = {"m/s²": STANDARD_GRAVITY, "g": 1.0, "mg": 1000.0}
"""Of gravity by the unit."""
STEADY = 0.02
"""Std of a vector's length over its mean, below which it is gravity; a gyroscope's changes as much as its mean."""
FASTEST_UNKNOWN = 0.3
"""rad/s, root mean square, up to which the turn about the vertical may stay unknown: of a tool of 0.1 m it adds a
thousandth of its weight's torque."""
TILT_TIME = 0.1
"""Seconds over which the direction turns and the gyroscope is averaged, against an accelerometer's noise."""
DEGREES_SHARE = 0.13
"""Of the gyroscope's turn that the direction's must be: the root of a degree in radians, half way to that unit."""


def has_steady_length(vectors: Array) -> bool:
    """Whether vectors (n, 3) have the length of gravity in a known unit, all of them."""
    sizes = np.linalg.norm(vectors[np.isfinite(vectors).all(axis=1)], axis=1)
    if not len(sizes) or sizes.std() > STEADY * sizes.mean():
        return False
    return any(abs(sizes.mean() / length - 1) < GRAVITY_TOLERANCE for length in LENGTHS.values())


def in_si(vectors: Array, factor: float | None, where: str) -> Array:
    """Vectors (n, 3) in m/s² by a stated factor, else by their length. Raises InputError where it is not gravity's."""
    if factor is not None:
        return vectors * factor
    size = float(np.nanmedian(np.linalg.norm(vectors, axis=1)))
    for length in LENGTHS.values():
        if abs(size / length - 1) < GRAVITY_TOLERANCE:
            return vectors * (STANDARD_GRAVITY / length)
    what = f"the vector of gravity has a median length of {size:.3g}, neither 9.8 m/s² nor 1 g"
    remedy = 'state its unit in a map, units = { acceleration = "m/s²" } or "g", or give the log of a pose'
    raise InputError(what=what, where=where, remedy=remedy)


def level_quaternions(up: Array) -> Array:
    """Orientations (n, 4), x y z w, that bring the directions `up` (n, 3) to the world's z.

    Each follows the one before by the smallest turn between their directions.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    unit = up / np.linalg.norm(up, axis=1, keepdims=True)
    turns = Rotation.from_quat(
        np.vstack([_smallest_turn(unit[:1], np.array([[0.0, 0.0, 1.0]])), _smallest_turn(unit[1:], unit[:-1])])
    )
    reach = 1
    while reach < len(unit):  # products of the first 1, 2, 4, .. turns
        turns = Rotation.concatenate([turns[:reach], turns[:-reach] * turns[reach:]])
        reach *= 2
    return np.asarray(turns.as_quat())


def _smallest_turn(start: Array, end: Array) -> Array:
    """Quaternions (n, 4), of any length, of the smallest turns from unit vectors (n, 3) to others.

    Of opposite ones any half turn.
    """
    half = np.hstack([np.cross(start, end), 1 + np.sum(start * end, axis=1, keepdims=True)])
    opposite = np.linalg.norm(half, axis=1) < 1e-9
    if opposite.any():
        across = np.cross(start[opposite], np.eye(3)[np.argmin(np.abs(start[opposite]), axis=1)])
        half[opposite] = np.pad(across, ((0, 0), (0, 1)))
    return half


def extra_acceleration(specific_force: Array) -> dict[str, Array]:
    """World acceleration (n,) by axis, m/s², of accelerometer readings (n, 3) whose direction is taken as up."""
    extra = np.linalg.norm(specific_force, axis=1) - STANDARD_GRAVITY
    return dict(zip(ACCELERATION, (np.zeros_like(extra), np.zeros_like(extra), extra), strict=True))


def checked_rates(columns: dict[str, Array], where: str, *, stated: bool) -> tuple[dict[str, Array], bool]:
    """The columns (n,) of a motion with its angular velocity in rad/s, and whether it was in degrees per second.

    Raises InputError where the sensor turns too fast for its turn about the vertical to stay unknown.
    """
    direction = np.stack(_up(columns), axis=1)
    dt = float(columns["time"][1] - columns["time"][0])
    lag = max(round(TILT_TIME / dt), 1)
    turn = (direction[lag:] - direction[:-lag]) / (lag * dt)
    if not set(RATES) <= set(columns):
        speed = float(np.sqrt(np.mean(np.sum(turn**2, axis=1))))
        if speed < FASTEST_UNKNOWN:
            return columns, False
        what = f"gravity's direction in the sensor turns at {speed:.2g} rad/s, and nothing tells the turn about it"
        remedy = "log a gyroscope (wx, wy, wz) or the pose too; of poses at rest give one row each, without time"
        raise InputError(what=what, where=where, remedy=remedy)
    rate = np.stack([columns[name] for name in RATES], axis=1)
    mean = (np.cumsum(rate, axis=0)[lag:] - np.cumsum(rate, axis=0)[:-lag]) / lag
    expected = np.cross(0.5 * (direction[lag:] + direction[:-lag]), mean)  # d(up)/dt = up x omega in the sensor's axes
    slope = float((turn * expected).sum() / max(float((expected**2).sum()), 1e-12))
    if stated or abs(slope) > DEGREES_SHARE:
        return columns, False
    return columns | {name: np.radians(columns[name]) for name in RATES}, True


def _up(columns: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """The world's up in the sensor's axes, by component."""
    x, y, z, w = (columns[name] for name in QUATERNION)
    return 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x**2 + y**2)
