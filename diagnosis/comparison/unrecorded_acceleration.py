"""Whether a residual looks like mass times an acceleration of the sensor's origin that was not recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from estimation.model_response import model_response
from estimation.recordings.motion_limits import acceleration_is_recorded, world_axes
from modeling.chain.model import WrenchModel
from modeling.space import Space

Array = NDArray[np.float64]

INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")

MOST = 0.5
"""Share of a residual's power: an unrecorded acceleration explains more of the torque, and errors of the recorded
orientation or of the sensor explain less of the force."""


def lacks_acceleration(comparison: Comparison, model: WrenchModel) -> bool:
    """Whether the residual of a recording looks like an acceleration that was not recorded."""
    return inertial_share(comparison, model) > MOST and orientation_share(comparison) < MOST


def inertial_share(comparison: Comparison, model: WrenchModel) -> float:
    """Share of the torque residual's power that goes with the acceleration of the sensor's origin left out.

    About the centre of mass c that acceleration exerts no torque: whatever it is, torque t and force f measured at
    the sensor are t = c x f + I al + w x I w + b with the inertia I about c and a constant b (Newton and Euler), a
    linear least-squares problem in c, I and b. Zero where the acceleration was recorded, and in the plane.
    """
    recording = comparison.recording
    if comparison.space is not Space.SPACE or acceleration_is_recorded(recording):
        return 0.0
    base = model.base
    response = model_response(base, recording, np.zeros(len(base.parameters)))
    inertia = [i for i, parameter in enumerate(base.parameters) if parameter.name in INERTIA]
    force, torque = recording.wrench[:, :3], recording.wrench[:, 3:]
    through_centre = np.stack([np.cross(axis, force) for axis in np.eye(3)], axis=2)
    constant = np.broadcast_to(np.eye(3), through_centre.shape)
    columns = np.concatenate([through_centre, response.derivative[:, 3:, inertia], constant], axis=2)
    regressor = columns.reshape(-1, columns.shape[2])
    residual = comparison.residual[:, 3:] - comparison.residual[:, 3:].mean(axis=0)
    return 1 - _power_left(regressor, torque) / max(float(np.sum(residual**2)), np.finfo(float).tiny)


def orientation_share(comparison: Comparison) -> float:
    """Share of the force residual's power above its noise that goes with the recorded orientation, in six axes.

    Where the sensor is turned in its flange, its axes leak into each other or have other gains, the force's error is
    A w with the weight's direction w in the sensor and a constant matrix A; where gravity's direction is wrong, it is
    constant in the world; where the readings are late, it goes with dw/dt. Their torques are those of a force through
    the centre of mass as well. An acceleration of the origin goes with none of these. Noise is what differs from
    sample to sample, at most half of the power: more is an acceleration that changes from sample to sample.
    """
    residual = comparison.residual[:, :3] - comparison.residual[:, :3].mean(axis=0)
    axes = world_axes(comparison.recording)
    down = -axes[:, :, 2]
    linear = np.einsum("ij,nk->nijk", np.eye(3), down).reshape(-1, 3, 9)
    constant = np.broadcast_to(np.eye(3), axes.shape)
    columns = np.concatenate([linear, axes[:, :, :2], np.gradient(down, axis=0)[:, :, None], constant], axis=2)
    power = float(np.sum(residual**2))
    noise = len(residual) / 2 * float(np.mean(np.diff(residual, axis=0) ** 2, axis=0).sum())
    explained = power - _power_left(columns.reshape(-1, columns.shape[2]), residual)
    return float(explained / max(power - min(noise, power / 2), explained, np.finfo(float).tiny))


def _power_left(regressor: Array, series: Array) -> float:
    """What a linear least-squares fit with a regressor (3 n, k) leaves of the power of a series (n, 3)."""
    left = series.ravel() - regressor @ np.linalg.lstsq(regressor, series.ravel(), rcond=None)[0]
    return float(left @ left)
