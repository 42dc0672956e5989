"""What the recorded motion leaves unknown in a diagnosis, and whether the residual is that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from estimation.model_response import model_response
from estimation.recordings.motion_limits import acceleration_is_recorded, motion_limits, world_axes
from modeling.chain.model import WrenchModel
from modeling.space import Space

Array = NDArray[np.float64]

INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")

MOST = 0.5
"""Share of a residual's power: an unrecorded acceleration explains more of the torque, and errors of the recorded
orientation or of the sensor explain less of the force."""


def motion_notes(comparisons: Sequence[Comparison], model: WrenchModel) -> list[str]:
    """One line for each thing that the motion of a fitted recording leaves unknown."""
    lines = []
    for comparison in comparisons:
        limits = motion_limits(comparison.recording)
        lines += [f"{comparison.recording.name}: {limit}." for limit in limits]
        if lacks_acceleration([comparison], model):
            share = inertial_share(comparison, model)
            lines.append(
                f"{comparison.recording.name}: the residual looks like mass times an acceleration that was not "
                "recorded: its torque is that of a force through one point, the centre of mass or where a contact acts "
                f"({share:.0%} of its power); log the position."
            )
    return lines


def lacks_acceleration(comparisons: Sequence[Comparison], model: WrenchModel) -> bool:
    """Whether the residual of one of the recordings looks like an acceleration that was not recorded."""
    return any(inertial_share(c, model) > MOST and orientation_share(c) < MOST for c in comparisons)


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
    sample to sample.
    """
    residual = comparison.residual[:, :3] - comparison.residual[:, :3].mean(axis=0)
    axes = world_axes(comparison.recording)
    down = -axes[:, :, 2]
    linear = np.einsum("ij,nk->nijk", np.eye(3), down).reshape(-1, 3, 9)
    constant = np.broadcast_to(np.eye(3), axes.shape)
    columns = np.concatenate([linear, axes[:, :, :2], np.gradient(down, axis=0)[:, :, None], constant], axis=2)
    power, noise = np.sum(residual**2), len(residual) / 2 * np.mean(np.diff(residual, axis=0) ** 2, axis=0).sum()
    explained = power - _power_left(columns.reshape(-1, columns.shape[2]), residual)
    return float(explained / max(power - noise, explained, np.finfo(float).tiny))


def _power_left(regressor: Array, series: Array) -> float:
    """What a linear least-squares fit with a regressor (3 n, k) leaves of the power of a series (n, 3)."""
    left = series.ravel() - regressor @ np.linalg.lstsq(regressor, series.ravel(), rcond=None)[0]
    return float(left @ left)
