"""Gravity evidence: whether recordings show that their base does not stand upright, and where gravity points in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from estimation.gravity.gravity_estimate import (
    FEWEST_POSES,
    GravityEstimate,
    estimated_gravity,
    independent_samples,
    upright_direction,
)
from estimation.gravity.rotation_terms import rotation_terms
from estimation.gravity.weight_moments import WeightMoments
from estimation.recordings.recording import Recording
from estimation.recordings.sensor_frame import in_sensor_frame
from modeling.kinematics.quaternion import COMPONENTS
from modeling.rig.rig import Convention

Array = NDArray[np.float64]

STEP, LONGEST = 0.01, 20_000
"""Seconds between rows that are fitted, and the first rows of a recording among which they are."""
LEAST_UNEXPLAINED = 0.01
"""Share of the readings' power that an upright base has to leave before another one is sought."""


def gravity_evidence(
    recordings: Sequence[Recording], *, gravity: float, convention: Convention, mirror_y: bool = False
) -> GravityEstimate | None:
    """The direction where the base clearly does not stand upright, and no other mistake explains as much; else None.

    The recordings, of one sensor, are in base axes; gravity in m/s². The signs are those of planar readings, and decide
    of six axes between directions that poses at rest do not distinguish.
    """
    if recordings[0].dimension == 2:
        signs = np.array([1.0, -1.0 if mirror_y else 1.0]) * (-1.0 if convention is Convention.ON_SENSOR else 1.0)
        return _in_plane(recordings, gravity, signs)
    if any("qw" not in r.signals for r in recordings) or sum(r.samples for r in recordings) < FEWEST_POSES:
        return None
    samples = [FrameSamples.of(recording) for recording in recordings]
    moments = _moments(samples, gravity)
    if not _leaves_enough(moments):
        return None
    independent = sum(independent_samples(r.samples, at_rest=r.at_rest) for r in recordings)
    found = estimated_gravity(moments, independent, convention)
    if found is None or not found.is_overwhelming:
        return None
    mistakes = ([mistake(own) for own in samples] for mistake in MISTAKES)
    upright = upright_direction(3)
    least = min(_moments(mistaken, gravity).fit(upright).rms for mistaken in mistakes)
    return found if found.fit.rms < least else None


def _in_plane(recordings: Sequence[Recording], gravity: float, signs: Array) -> GravityEstimate | None:
    """From runs alone: in poses at rest a turned base is indistinguishable from a sensor that is mounted turned."""
    if any(recording.at_rest or "phi" not in recording.signals for recording in recordings):
        return None
    moments = reduce(add, (_planar_moments(recording, gravity, signs) for recording in recordings))
    if not _leaves_enough(moments):
        return None
    independent = sum(independent_samples(r.samples, at_rest=False) for r in recordings)
    found = estimated_gravity(moments, independent)
    right = found is not None and found.decided and found.is_overwhelming and np.trace(found.fit.matrix) > 0
    return found if right else None


def _leaves_enough(moments: WeightMoments) -> bool:
    """Whether an upright base leaves so much of the readings that another one may explain it."""
    upright = moments.fit(upright_direction(moments.axes))
    return upright.rms**2 > LEAST_UNEXPLAINED * moments.force**2


@dataclass(frozen=True, eq=False)
class FrameSamples:
    """Rows of one recording that are fitted: quaternion x y z w (4, n), accelerations and forces (n, 3), turning."""

    quaternion: Array
    acceleration: Array
    force: Array
    rotation: Array | None

    @classmethod
    def of(cls, recording: Recording) -> FrameSamples:
        """From the recording's signals, in base axes."""
        every, signals = _every(recording), recording.signals
        return cls(
            np.stack([signals[name][every] for name in COMPONENTS]),
            np.stack([signals[name][every] for name in ("apx", "apy", "apz")], axis=1),
            recording.wrench[every, :3],
            None if recording.at_rest else rotation_terms(recording, every),
        )

    @property
    def to_sensor(self) -> Array:
        """R' (n, 3, 3)."""
        signals = dict(zip(COMPONENTS, self.quaternion, strict=True))
        return np.stack([in_sensor_frame(signals, axis) for axis in np.eye(3).tolist()], axis=2)


def _w_first(samples: FrameSamples) -> FrameSamples:
    return replace(samples, quaternion=np.roll(samples.quaternion, -1, axis=0))


def _inverse(samples: FrameSamples) -> FrameSamples:
    return replace(samples, quaternion=samples.quaternion * np.array([[-1.0], [-1.0], [-1.0], [1.0]]))


def _in_base_axes(samples: FrameSamples) -> FrameSamples:
    return replace(samples, force=np.einsum("nij,nj->ni", samples.to_sensor, samples.force))


MISTAKES = (_w_first, _inverse, _in_base_axes)
"""Other readings of orientation and axes, of which each may seem to turn gravity."""


def _moments(samples: Sequence[FrameSamples], gravity: float) -> WeightMoments:
    each = (WeightMoments.of(s.to_sensor, s.acceleration, s.force, gravity, s.rotation) for s in samples)
    return reduce(add, each)


def _planar_moments(recording: Recording, gravity: float, signs: Array) -> WeightMoments:
    """Forces with the signs of the sensor's on the tool, in the axes x' and -y' of the sensor."""
    every, signals = _every(recording), recording.signals
    s, c = np.sin(signals["phi"][every]), np.cos(signals["phi"][every])
    to_sensor = np.stack([np.stack([c, -s], axis=1), np.stack([-s, -c], axis=1)], axis=1)
    force = recording.wrench[every, :2] * signs
    acceleration = np.stack([signals["ax"][every], signals["ay"][every]], axis=1)
    return WeightMoments.of(to_sensor, acceleration, force, gravity, rotation_terms(recording, every))


def _every(recording: Recording) -> slice:
    """The rows that are fitted: no more than a hundred a second, among the first of a long recording."""
    stride = 1 if recording.dt is None else max(int(STEP / recording.dt), 1)
    return slice(0, LONGEST, stride)
