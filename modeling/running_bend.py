"""Running bend: the bend of a tool on a spring, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from modeling.errors import InputError
from modeling.operators.equilibrium import Equilibrium

Array = NDArray[np.float64]

NEWTON_STEPS = 8
"""Each doubles the digits; from the bend of one sample to the next four are enough, from none at all to a radian seven.

Always the same number, so that every sample takes the same time."""


@dataclass(frozen=True, eq=False)
class SampledBend:
    """How d angles can go on in a step of dt: mass b'' + lag b' + b = drive, the drive straight between samples.

    bend = (b, b', b'') is carry (3 d, 2 d) times (b, b') of the last sample, plus past (3 d, d) times its drive, plus
    now (3 d, d) times the drive of this one. At rest bend = rest (3 d, d) times the drive.
    """

    carry: Array
    past: Array
    now: Array

    @classmethod
    def of(cls, equation: Equilibrium, signals: int, theta: Array, dt: float) -> Self:
        """That of the tool's own inertia and damping, where nothing is bent; dt in s.

        Raises InputError when the inertia is not that of a body.
        """
        size = equation.size
        _, slopes = equation.at(np.zeros((1, signals)), np.zeros((1, 3 * size)), theta)
        lag, mass = slopes[0, :, size : 2 * size], slopes[0, :, 2 * size :]
        if not (np.isfinite(mass).all() and np.linalg.eigvalsh((mass + mass.T) / 2).min() > 0):
            what = "the tool's inertia is not positive, and on a spring it would run away"
            raise InputError(what=what, where="tip_flexibility", remedy="fit it with --physical, or leave it out")
        return cls(*_straight(mass, lag, dt))

    @property
    def size(self) -> int:
        """The number of angles d."""
        return int(self.past.shape[1])

    @property
    def rest(self) -> Array:
        """(1, 0, 0): without rates the drive is the angle itself."""
        return np.eye(3 * self.size, self.size)


def _straight(mass: Array, lag: Array, dt: float) -> tuple[Array, Array, Array]:
    """Carry, past and now, by the exponential of the system with its drive and the drive's slope; rates times dt."""
    size = len(mass)
    give = np.asarray(np.linalg.inv(mass), dtype=float)
    one: Array = np.eye(size)
    none: Array = np.zeros((size, size))
    rows: list[list[Array]] = [
        [none, one, none, none],
        [-(dt**2) * give, -dt * give @ lag, dt**2 * give, none],
        [none, none, none, one],
        [none, none, none, none],
    ]
    step = expm(np.block(rows))[: 2 * size]
    units = np.concatenate([np.ones(size), np.full(size, 1 / dt)])
    free = units[:, None] * step[:, : 2 * size] / units
    slope = units[:, None] * step[:, 3 * size :]
    held = units[:, None] * step[:, 2 * size : 3 * size] - slope
    second = -give @ np.hstack([one, lag])
    return (
        np.vstack([free, second @ free]),
        np.vstack([held, second @ held]),
        np.vstack([slope, second @ slope + give]),
    )


class RunningBend:
    """The bend (3 d,) after each sample: the drive is sought with which the equilibrium holds at the sample.

    It starts from the static equilibrium of the first sample, without rates. Of a drive at the angular frequency w the
    straight lines between samples lose the part (w dt)² / 12.
    """

    def __init__(self, equation: Equilibrium, signals: int, theta: Array, dt: float) -> None:
        self._equation, self._theta = equation, theta
        self.sampled = SampledBend.of(equation, signals, theta, dt)
        self._state: Array | None = None
        self._drive = np.zeros(self.sampled.size)

    def step(self, u: Array) -> Array:
        """Angles, rates and accelerations (3 d,) under the signals u (m,)."""
        sampled, drive = self.sampled, self._drive
        if self._state is None:
            free, column = np.zeros(3 * sampled.size), sampled.rest
        else:
            free, column = sampled.carry @ self._state + sampled.past @ drive, sampled.now
        for _ in range(NEWTON_STEPS):
            value, slopes = self._equation.at(u[None], (free + column @ drive)[None], self._theta)
            drive = drive - np.linalg.solve(slopes[0] @ column, value[0])
        bend = np.asarray(free + column @ drive)
        self._state, self._drive = bend[: 2 * sampled.size], drive
        return bend
