"""Commanded joint motion and its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from truewrench.simulated_rig.mujoco_scene import Array, States

Spectrum = npt.NDArray[np.complexfloating[Any, Any]]


class PeriodicMotion(Protocol):
    """A motion of the rig's coordinates that repeats; `design.trajectories.trajectory.Motion` is one."""

    @property
    def period(self) -> float:
        """Seconds."""

    def evaluate(self, time: Array) -> States:
        """q, dq, ddq, each (N, n), at the times (N,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandedMotion:
    """Commanded motion: states q, dq, ddq and jerk, each (N, n), at the times (N,) s.

    period of a uniform grid over one period of the motion, s; None for independent instants.
    """

    time: Array
    states: States
    jerk: Array
    period: float | None = None

    @classmethod
    def along(cls, motion: PeriodicMotion, time: Array, *, whole_period: bool = False) -> CommandedMotion:
        """Of a motion at the times; with whole_period they are a uniform grid over one period."""
        return cls(
            time=time,
            states=motion.evaluate(time),
            jerk=_jerk(motion, time),
            period=motion.period if whole_period else None,
        )

    @classmethod
    def resting(cls, q: Array, time: Array) -> CommandedMotion:
        """In static poses (N, n)."""
        return cls(time=time, states=(q, np.zeros_like(q), np.zeros_like(q)), jerk=np.zeros_like(q))

    def filtered(self, values: Array, response: Callable[[Spectrum], Spectrum]) -> Array:
        """Periodic steady state of values (N, k) after the transfer function response(s), (F, k, k), s (F,) = i w, 1/s.

        Independent instants are static: s = 0.
        """
        if self.period is None:
            return np.asarray(values @ response(np.zeros(1, dtype=complex))[0].real.T)
        spectrum = np.fft.rfft(values, axis=0)
        s = 2j * np.pi / self.period * np.arange(len(spectrum))
        through = (response(s) @ spectrum[:, :, None])[:, :, 0]
        return np.fft.irfft(through, n=len(values), axis=0)

    def rate(self, values: Array) -> Array:
        """Time derivative of values (N, k)."""
        return self.filtered(values, lambda s: s[:, None, None] * np.eye(values.shape[1]))


_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Weights of the central difference of eighth order (B. Fornberg, Math. Comp. 51, 1988, table 1)."""
_STEPS = 2000
"""Steps per period: up to the 20th harmonic the truncation error is 1e-12 of the jerk, equal to rounding."""


def _jerk(motion: PeriodicMotion, time: Array) -> Array:
    step = motion.period / _STEPS

    def acceleration(shift: int) -> Array:
        return motion.evaluate(time + shift * step)[2]

    differences = (w * (acceleration(k) - acceleration(-k)) for k, w in enumerate(_WEIGHTS, start=1))
    return np.asarray(sum(differences, np.zeros(1)) / step)
