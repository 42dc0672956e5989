"""Recordings of a sensor that is turned by any constant rotation against the pose that is logged.

A simulator of its own: point masses, moved as a function of time that is differentiated by hand, and matrices. It
shares no equation with the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.rig import Rig

Array = NDArray[np.float64]

GRAVITY = 9.806
MASSES = np.array([0.3, 0.2, 0.25, 0.15, 0.2, 0.1])
PLACES = np.array(
    [
        [0.09, -0.02, 0.05],
        [-0.06, -0.03, 0.09],
        [0.02, 0.06, 0.13],
        [0.01, -0.11, 0.02],
        [0.0, 0.0, 0.14],
        [-0.05, 0, 0],
    ]
)
"""Point masses (kg) of the tool and their places (m) in sensor axes, from the sensor's origin."""
MASS, CENTRE = float(MASSES.sum()), MASSES @ PLACES / MASSES.sum()
CONTACT = np.array([-6.0, 2.0, 10.0, 0.3, -0.2, 0.1])
"""The environment's on the tool, in sensor axes, N and N m."""
ZERO = np.array([3.0, -2.0, 5.0, 0.1, -0.05, 0.02])
STEP, SAMPLES, REPEATS, PERIOD = 0.02, 250, 4, 5.0
PUSHED = (0.3, 0.5)
"""Part of each repeat during which the environment pushes."""


def inertia(masses: Array, places: Array) -> Array:
    """About the centre of mass, along the places' axes."""
    about = places - masses @ places / masses.sum()
    return np.asarray(sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, about, strict=True)))


@dataclass(frozen=True, eq=False)
class TurnedSensor:
    """A sensor with a tool, read `on_sensor`.

    to_pose  rotation from the sensor's axes to those of the logged pose
    gravity  direction in base axes
    """

    to_pose: Rotation
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def pose(self, time: NDArray[Any]) -> Rotation:
        """Of the frame that is logged, in the base; three axes, each a function of time."""
        w = 2 * np.pi / PERIOD
        angles = [1.4 * np.sin(w * time), 1.1 * np.sin(2 * w * time + 0.7), 1.7 * np.cos(w * time + 0.3)]
        return Rotation.from_euler("XYZ", np.stack(angles, axis=1))

    def columns(self, *, pushed: bool = False, noise: float = 0.02, seed: int = 0) -> dict[str, Array]:
        """Of a recording with repeats: the pose, its rates and the readings; noise in N, and a tenth of it in N m."""
        time = np.arange(REPEATS * SAMPLES) * STEP
        sensor, h = self.pose(time) * self.to_pose, 1e-4
        before, after = (self.pose(time + s) * self.to_pose for s in (-h, h))
        # Orientation to second order about each instant: rotation vectors of half a step each way.
        forth, back = (sensor.inv() * after).as_rotvec(), (sensor.inv() * before).as_rotvec()
        omega, alpha = (forth - back) / (2 * h), (forth + back) / h**2
        w = 2 * np.pi / PERIOD
        position = 0.1 * np.stack([np.sin(w * time), np.cos(2 * w * time), np.sin(w * time + 1)], axis=1)
        acceleration = position * -np.array([w**2, 4 * w**2, w**2])
        lift = sensor.inv().apply(acceleration - GRAVITY * np.array(self.gravity))
        force, torque = np.zeros((2, len(time), 3))
        for mass, place in zip(MASSES, PLACES, strict=True):
            share = mass * (lift + np.cross(alpha, place) + np.cross(omega, np.cross(omega, place)))
            force, torque = force + share, torque + np.cross(place, share)
        on_tool = np.concatenate([force, torque], axis=1)
        inside = (time % PERIOD >= PUSHED[0] * PERIOD) & (time % PERIOD < PUSHED[1] * PERIOD)
        on_tool = on_tool - (CONTACT * inside[:, None] if pushed else 0.0)
        size = noise * np.array([1, 1, 1, 0.1, 0.1, 0.1])
        readings = -on_tool + ZERO + np.random.default_rng(seed).normal(0, 1, (len(time), 6)) * size
        logged = self.pose(time).as_quat()
        names = ["fx", "fy", "fz", "tx", "ty", "tz"]
        vectors = {"p": position, "ap": acceleration, "w": self.to_pose.apply(omega), "al": self.to_pose.apply(alpha)}
        return {
            "time": time,
            "repeat": np.repeat(np.arange(REPEATS), SAMPLES),
            **dict(zip(("qx", "qy", "qz", "qw"), logged.T, strict=True)),
            **{name + axis: v[:, i] for name, v in vectors.items() for i, axis in enumerate("xyz")},
            **dict(zip(names, readings.T, strict=True)),
        }

    def recording(self, *, pushed: bool = False, noise: float = 0.02, seed: int = 0) -> Recording:
        """The same as a recording; of a base that does not stand upright with the rig that says so."""
        rig = None if self.gravity == (0.0, 0.0, -1.0) else Rig(gravity_direction=self.gravity)
        name = "pushed.csv" if pushed else "run.csv"
        return from_columns(self.columns(pushed=pushed, noise=noise, seed=seed), name=name, rig=rig)
