"""What the recorded motion leaves unknown in a diagnosis, and whether the residual is that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.comparison.comparison import Comparison
from estimation.least_squares.estimates import Estimate
from estimation.recordings.motion_limits import acceleration_is_recorded, motion_limits
from modeling.space import Space

LIKELY_SHARE = 0.5
"""Of the torque residual's power, from which it is said to be that of an unrecorded acceleration."""


def motion_notes(comparisons: Sequence[Comparison], parameters: Mapping[str, Estimate]) -> list[str]:
    """One line for each thing that the motion of a fitted recording leaves unknown."""
    lines = []
    for comparison in comparisons:
        limits = motion_limits(comparison.recording)
        lines += [f"{comparison.recording.name}: {limit}." for limit in limits]
        share = inertial_share(comparison, parameters)
        if share > LIKELY_SHARE:
            lines.append(
                f"{comparison.recording.name}: the residual looks like mass times an acceleration that was not "
                f"recorded: its torque is that of a force through the centre of mass ({share:.0%} of its power); "
                "log the position."
            )
    return lines


def inertial_share(comparison: Comparison, parameters: Mapping[str, Estimate]) -> float:
    """Share of the torque residual's power that the force residual makes at the centre of mass.

    An acceleration a of the sensor's origin that was not recorded leaves a force residual m a and, with the first
    moment s, a torque residual s x a = (s / m) x (m a), in six axes whatever a is. Zero where the acceleration was
    recorded, in the plane, and where the mass is not known to be positive.
    """
    known = [name for name in ("m", "mx", "my", "mz") if name in parameters]
    if len(known) < 4 or acceleration_is_recorded(comparison.recording):
        return 0.0
    mass, *moment = (parameters[name].value for name in known)
    if comparison.space is not Space.SPACE or not mass > 0:
        return 0.0
    centre = np.array(moment) / mass
    residual = comparison.residual - comparison.residual.mean(axis=0)
    expected, torque = np.cross(centre, residual[:, :3]), residual[:, 3:]
    return float(1 - np.sum((torque - expected) ** 2) / max(np.sum(torque**2), np.finfo(float).tiny))
