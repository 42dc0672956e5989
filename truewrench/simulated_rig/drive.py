"""Drive: what a rig's drives are told at some instants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from truewrench.simulated_rig.scene import Array, States

Spectrum = npt.NDArray[np.complexfloating[Any, Any]]


class PeriodicMotion(Protocol):
    """A motion of the rig's coordinates that repeats; `design.motion.series.Motion` is one."""

    @property
    def period(self) -> float:
        """Seconds."""

    def evaluate(self, time: Array) -> States:
        """q, dq, ddq, each (N, n), at the times (N,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """What the drives are told: at the times (N,) s the states q, dq, ddq and the jerk, each (N, n).

    period is that of an even grid over one period of a motion, s; None: instants that know nothing of each other.
    """

    time: Array
    states: States
    jerk: Array
    period: float | None = None

    @classmethod
    def along(cls, motion: PeriodicMotion, time: Array, *, whole_period: bool = False) -> Drive:
        """Of a motion; the times are an even grid over one period if that is said."""
        return cls(
            time=time,
            states=motion.evaluate(time),
            jerk=_jerk(motion, time),
            period=motion.period if whole_period else None,
        )

    @classmethod
    def resting(cls, q: Array, time: Array) -> Drive:
        """In poses (N, n) at rest."""
        return cls(time=time, states=(q, np.zeros_like(q), np.zeros_like(q)), jerk=np.zeros_like(q))

    def filtered(self, values: Array, response: Callable[[Spectrum], Spectrum]) -> Array:
        """Values (N, k) in their periodic steady state after response(s), (F, k, k) at s (F,) = i w, 1/s.

        Instants that know nothing of each other are at rest: s = 0.
        """
        if self.period is None:
            return np.asarray(values @ response(np.zeros(1, dtype=complex))[0].real.T)
        spectrum = np.fft.rfft(values, axis=0)
        s = 2j * np.pi / self.period * np.arange(len(spectrum))
        through = (response(s) @ spectrum[:, :, None])[:, :, 0]
        return np.fft.irfft(through, n=len(values), axis=0)

    def rate(self, values: Array) -> Array:
        """The derivative by time of values (N, k)."""
        return self.filtered(values, lambda s: s[:, None, None] * np.eye(values.shape[1]))


_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Of the central difference of eighth order (B. Fornberg, Math. Comp. 51, 1988, table 1)."""
_STEPS = 2000
"""To a period: up to the 20th harmonic the difference is wrong by 1e-12 of the jerk, which is also its rounding."""


def _jerk(motion: PeriodicMotion, time: Array) -> Array:
    step = motion.period / _STEPS

    def acceleration(shift: int) -> Array:
        return motion.evaluate(time + shift * step)[2]

    differences = (w * (acceleration(k) - acceleration(-k)) for k, w in enumerate(_WEIGHTS, start=1))
    return np.asarray(sum(differences, np.zeros(1)) / step)
