"""BendStepper: the bend of a tool on a spring, one sample at a time, as emitted code runs it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from modeling.operators.bending import solve
from modeling.operators.clock import Clock
from modeling.operators.equilibrium import Equilibrium

Array = NDArray[np.float64]

CORRECTIONS = 3
"""Newton steps a sample; they begin at the last acceleration and reach rounding for bends of less than 0.1 rad."""


@dataclass(eq=False)
class BendStepper:
    """Newmark's rule of average acceleration (1959): linearly implicit, stable at any step, without damping of its own.

    With a' the new acceleration, b' = b + dt v + dt² (a + a')/4 and v' = v + dt (a + a')/2, and a' such that the
    equilibrium holds at the new sample. Newton's matrix is F_a + dt/2 F_v + dt²/4 F_b, d by d.

    Its error is of second order: at a frequency f well below the tool's own f0 the bend is wrong by the share
    (f/f0)² (2 pi f dt)²/12, and the tool rings at f0 (1 - (2 pi f0 dt)²/12). It begins in the static equilibrium of its
    first sample, without velocity.

    theta (k,); dt in s; `state` holds angles, rates and accelerations (3 d,) after the last sample.
    """

    equations: Equilibrium
    theta: Array
    dt: float
    state: Array | None = field(default=None, init=False)

    def step(self, signals: Array) -> Array:
        """The bend (3 d,) at the next sample's signals (m,)."""
        sample = np.asarray(signals, dtype=np.float64)[None, :]
        if self.state is None:
            static = solve(self.equations, sample, self.theta, Clock(None, False), derivative=False)
            self.state = static.values[0]
            return self.state
        b, v, a = np.split(self.state, 3)
        change = np.zeros_like(a)
        for _ in range(CORRECTIONS):
            state = self._after(b, v, a, change)
            value, slopes = self.equations.at(sample, state[None, :], self.theta)
            by_b, by_v, by_a = np.split(slopes[0], 3, axis=1)
            change = change - np.linalg.solve(by_a + self.dt / 2 * by_v + self.dt**2 / 4 * by_b, value[0])
        self.state = self._after(b, v, a, change)
        return self.state

    def _after(self, b: Array, v: Array, a: Array, change: Array) -> Array:
        new, dt = a + change, self.dt
        return np.concatenate([b + dt * v + dt**2 / 4 * (a + new), v + dt / 2 * (a + new), new])
