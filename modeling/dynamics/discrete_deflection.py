"""Time discretisation of the deflection, solved sample by sample with Newton's method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from modeling.dynamics.equation_of_motion import EquationOfMotion
from modeling.errors import InputError

Array = NDArray[np.float64]

NEWTON_STEPS = 8
"""Newton steps per sample, each doubling the correct digits: four suffice from sample to sample, seven from 0 to 1 rad.

A fixed number, so that every sample takes the same time."""


@dataclass(frozen=True, eq=False)
class DiscreteDeflection:
    """First-order-hold discretisation with step dt of mass b'' + lag b' + b = input, for d angles b.

    (b, b', b'') = carry (3 d, 2 d) (b, b')_last + past (3 d, d) input_last + now (3 d, d) input; in static equilibrium
    (b, b', b'') = rest (3 d, d) input.
    """

    carry: Array
    past: Array
    now: Array

    @classmethod
    def of(cls, equation: EquationOfMotion, signals: int, theta: Array, dt: float) -> Self:
        """With the tool's inertia and damping at zero deflection; dt in s.

        Raises InputError when the inertia is not positive definite.
        """
        size = equation.size
        _, slopes = equation.at(np.zeros((1, signals)), np.zeros((1, 3 * size)), theta)
        lag, mass = slopes[0, :, size : 2 * size], slopes[0, :, 2 * size :]
        if not (np.isfinite(mass).all() and np.linalg.eigvalsh((mass + mass.T) / 2).min() > 0):
            what = "the tool's inertia is not positive: the deflection is unstable"
            raise InputError(what=what, where="tip_flexibility", remedy="fit it with --physical, or leave it out")
        return cls(*_first_order_hold(mass, lag, dt))

    @property
    def size(self) -> int:
        """The number of angles d."""
        return int(self.past.shape[1])

    @property
    def rest(self) -> Array:
        """(1, 0, 0): in static equilibrium the input is the angle itself."""
        return np.eye(3 * self.size, self.size)


def _first_order_hold(mass: Array, lag: Array, dt: float) -> tuple[Array, Array, Array]:
    """Carry, past and now, by the exponential of the system augmented by input and input slope; rates times dt."""
    size = len(mass)
    inverse = np.asarray(np.linalg.inv(mass), dtype=float)
    one: Array = np.eye(size)
    zero: Array = np.zeros((size, size))
    rows: list[list[Array]] = [
        [zero, one, zero, zero],
        [-(dt**2) * inverse, -dt * inverse @ lag, dt**2 * inverse, zero],
        [zero, zero, zero, one],
        [zero, zero, zero, zero],
    ]
    step = expm(np.block(rows))[: 2 * size]
    units = np.concatenate([np.ones(size), np.full(size, 1 / dt)])
    free = units[:, None] * step[:, : 2 * size] / units
    slope = units[:, None] * step[:, 3 * size :]
    held = units[:, None] * step[:, 2 * size : 3 * size] - slope
    second = -inverse @ np.hstack([one, lag])
    return (
        np.vstack([free, second @ free]),
        np.vstack([held, second @ held]),
        np.vstack([slope, second @ slope + inverse]),
    )


class DeflectionIntegrator:
    """The deflection (3 d,) sample by sample: Newton's method for the input with which the equation of motion holds.

    It starts from the static equilibrium of the first sample. At the angular frequency w the relative error of the
    first-order hold is (w dt)² / 12.
    """

    def __init__(self, equation: EquationOfMotion, signals: int, theta: Array, dt: float) -> None:
        self._equation, self._theta = equation, theta
        self.sampled = DiscreteDeflection.of(equation, signals, theta, dt)
        self._state: Array | None = None
        self._drive = np.zeros(self.sampled.size)

    def step(self, u: Array) -> Array:
        """Angles, rates and accelerations (3 d,) under the signals u (m,)."""
        sampled, drive = self.sampled, self._drive
        if self._state is None:
            free, gain = np.zeros(3 * sampled.size), sampled.rest
        else:
            free, gain = sampled.carry @ self._state + sampled.past @ drive, sampled.now
        for _ in range(NEWTON_STEPS):
            value, slopes = self._equation.at(u[None], (free + gain @ drive)[None], self._theta)
            drive = drive - np.linalg.solve(slopes[0] @ gain, value[0])
        deflection = np.asarray(free + gain @ drive)
        self._state, self._drive = deflection[: 2 * sampled.size], drive
        return deflection
