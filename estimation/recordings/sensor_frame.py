"""World vectors in the frame of a sensor whose orientation is recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.kinematics.quaternion import COMPONENTS, quaternion_conjugate, rotated_vector

Array = NDArray[np.float64]


def in_sensor_frame(signals: Mapping[str, Array], vector: Sequence[Any]) -> Array:
    """A world vector of three components, numbers or (n,), in the sensor frame, (n, 3): R(q / |q|)' v.

    `scipy.spatial.transform` has it too, but its import takes longer than reading a recording.
    """
    quaternions = np.stack([signals[name] for name in COMPONENTS])
    unit = quaternions / np.linalg.norm(quaternions, axis=0)
    return np.stack(rotated_vector(quaternion_conjugate(unit), vector), axis=1)


def to_sensor_frame(quaternions: Array) -> Array:
    """Rotation matrices R(q / |q|)' (n, 3, 3) to the sensor frame from quaternions (n, 4), x y z w."""
    signals = dict(zip(COMPONENTS, quaternions.T, strict=True))
    return np.stack([in_sensor_frame(signals, axis) for axis in np.eye(3).tolist()], axis=2)
