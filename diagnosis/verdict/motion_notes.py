"""What the recorded motion leaves unknown in a diagnosis, and whether the residual is that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.comparison.comparison import Comparison
from estimation.model_response import model_response
from estimation.recordings.motion_limits import acceleration_is_recorded, motion_limits
from modeling.chain.model import WrenchModel
from modeling.space import Space

INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")

LIKELY_SHARE = 0.5
"""Of the torque residual's power, from which it is said to be that of an unrecorded acceleration."""


def motion_notes(comparisons: Sequence[Comparison], model: WrenchModel) -> list[str]:
    """One line for each thing that the motion of a fitted recording leaves unknown."""
    lines = []
    for comparison in comparisons:
        limits = motion_limits(comparison.recording)
        lines += [f"{comparison.recording.name}: {limit}." for limit in limits]
        share = inertial_share(comparison, model)
        if share > LIKELY_SHARE:
            lines.append(
                f"{comparison.recording.name}: the residual looks like mass times an acceleration that was not "
                "recorded: its torque is that of a force through one point, the centre of mass or where a contact acts "
                f"({share:.0%} of its power); log the position."
            )
    return lines


def lacks_acceleration(comparisons: Sequence[Comparison], model: WrenchModel) -> bool:
    """Whether the residual of one of the recordings looks like an acceleration that was not recorded."""
    return any(inertial_share(comparison, model) > LIKELY_SHARE for comparison in comparisons)


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
    left = torque.ravel() - regressor @ np.linalg.lstsq(regressor, torque.ravel(), rcond=None)[0]
    residual = comparison.residual[:, 3:] - comparison.residual[:, 3:].mean(axis=0)
    return float(1 - np.sum(left**2) / max(np.sum(residual**2), np.finfo(float).tiny))
