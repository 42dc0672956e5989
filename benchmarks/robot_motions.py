"""Motions of a tool in six axes as robots make them: sums of sines, point to point with dwells, rows of a raster."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truewrench.simulated_rig import PeriodicMotion, PlanarRig, SpatialRig

Array = NDArray[np.float64]

PERIOD = 15.0
"""Seconds: the whole of a single run, which ends where it began."""
HARMONICS = 12
"""Of the sines: up to 0.8 Hz."""
POINTS, MOVE, STOP = 12, 0.8, 0.45
"""Places of a point-to-point motion; moves and dwells, s."""
ROWS, LONG_MOVE, SHORT_MOVE, DWELL = 12, 1.0, 0.5, 0.05
"""Rows of a raster; moves along and across them and dwells between, before the whole is scaled to the period."""


@dataclass(frozen=True, eq=False)
class QuinticPath:
    """Moves of minimum jerk between poses, and dwells, repeated from the last pose, which is the first.

    poses        (k + 1, 6), m and rad
    start, move  (k,) when each move begins and how long it takes, s; the next begins after a dwell
    """

    period: float
    poses: Array
    start: Array
    move: Array

    @classmethod
    def through(cls, poses: Array, move: Array, dwell: float, period: float = PERIOD) -> QuinticPath:
        """Through poses (k, 6) and back, k moves (k,) and dwells in proportion, scaled to the period."""
        scale = period / (move + dwell).sum()
        start = np.concatenate([[0.0], np.cumsum(move + dwell)[:-1]]) * scale
        return cls(period, np.concatenate([poses, poses[:1]]), start, move * scale)

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (n, 6), at the times (n,)."""
        time = np.asarray(time) % self.period
        i = np.searchsorted(self.start, time, side="right") - 1
        lasts, step = self.move[i][:, None], self.poses[i + 1] - self.poses[i]
        s = np.clip((time - self.start[i])[:, None] / lasts, 0, 1)
        return (
            self.poses[i] + step * (10 * s**3 - 15 * s**4 + 6 * s**5),
            step * (30 * s**2 - 60 * s**3 + 30 * s**4) / lasts,
            step * (60 * s - 180 * s**2 + 120 * s**3) / lasts**2,
        )


def sines(seed: int) -> PeriodicMotion:
    """Twelve harmonics of the period in every coordinate, within the limits of the rig."""
    return SpatialRig().random_motion(seed=seed, period=PERIOD, harmonics=HARMONICS)


def point_to_point(seed: int) -> QuinticPath:
    """Twelve random poses, with a dwell in each."""
    poses = np.random.default_rng(seed).uniform(-1, 1, (POINTS, 6)) * [0.25, 0.25, 0.2, 0.8, 0.8, 0.8]
    return QuinticPath.through(poses, np.full(POINTS, MOVE), STOP)


def raster(seed: int) -> QuinticPath:
    """Rows over a curved surface to and fro, with short dwells."""
    rng = np.random.default_rng(seed)
    across = np.repeat(np.linspace(-0.2, 0.2, ROWS), 2)
    along = np.tile([-0.25, 0.25, 0.25, -0.25], ROWS // 2)
    about_tip = 0.5 * np.sin(np.repeat(np.arange(ROWS), 2))
    turned = np.stack([2 * across, -2.4 * along, about_tip], axis=1) + 0.1 * rng.normal(size=(2 * ROWS, 3))
    poses = np.column_stack([along, across, 0.1 * (along**2 + across**2), turned])
    move = np.append(np.resize([LONG_MOVE, SHORT_MOVE], 2 * ROWS - 1), 1.5 * LONG_MOVE)
    return QuinticPath.through(poses, move, DWELL)


@dataclass(frozen=True, eq=False)
class NearlyRepeated:
    """A motion of a rig that repeats but for `size` (rad, m) in every coordinate; its period is the whole record.

    repeat   s, of which there are `repeats`
    """

    rig: PlanarRig | SpatialRig
    size: float
    seed: int
    repeat: float
    repeats: int

    @property
    def period(self) -> float:
        """Seconds, of all repeats."""
        return self.repeat * self.repeats

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """States at the times (n,)."""
        states = self.rig.random_motion(seed=self.seed, period=self.repeat).evaluate(time)
        rng = np.random.default_rng(self.seed)
        lines = rng.choice(np.arange(1, 10 * self.repeats), 12, replace=False)
        omega = 2 * np.pi * lines[lines % self.repeats > 0] / self.period
        phase = np.multiply.outer(time, omega)[:, :, None] + rng.uniform(0, 6.3, (len(omega), self.rig.coordinates))
        size = self.size * np.sqrt(2 / len(omega))
        added = (np.sin(phase), np.cos(phase) * omega[:, None], -np.sin(phase) * omega[:, None] ** 2)
        q, dq, ddq = (state + size * part.sum(axis=1) for state, part in zip(states, added, strict=True))
        return q, dq, ddq


MOTIONS: Mapping[str, Callable[[int], PeriodicMotion]] = {
    "sines": sines,
    "point to point": point_to_point,
    "raster": raster,
}
"""A motion by its kind, of a seed."""
