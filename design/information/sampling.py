"""Sampling: the instants at which a motion is read, and filters over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Response = Callable[[Array], NDArray[np.complex128]]
"""A transfer function at angular frequencies (L,) in rad/s: (L,)."""

CLOCK = ("time", "progress")
"""Signals that the instants themselves give: s from the start, and -1 to 1 over the record."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """N equally spaced samples of one motion over `duration` (s).

    A periodic motion is read at j T / N in its steady state, as it is after earlier periods. Another one is read from
    its first instant to its last, and stood still in its first posture before.
    """

    duration: float
    samples: int
    periodic: bool = True

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return self.duration / (self.samples if self.periodic else max(self.samples - 1, 1))

    @property
    def time(self) -> Array:
        """The instants (N,), s."""
        return np.asarray(np.arange(self.samples) * self.step, dtype=float)

    @property
    def clock(self) -> Array:
        """The signals of `CLOCK`, (2, N)."""
        return np.stack([self.time, np.linspace(-1.0, 1.0, self.samples)])

    def through(self, response: Response, series: Array) -> Array:
        """A series (N, ...) through a transfer function, by a real discrete Fourier transform.

        One period of a periodic motion is filtered exactly, line by line (at half the sampling rate the samples show
        the real part alone). Any other series is continued by as many samples of its first value, from which a motion
        that comes back to its first posture starts and at which it ends: exact when the filter has forgotten after
        them.
        """
        closed = series if self.periodic else np.concatenate([series, np.repeat(series[:1], len(series), axis=0)])
        omega = np.asarray(2 * np.pi * np.fft.rfftfreq(len(closed), self.step), dtype=float)
        gain = response(omega).reshape(-1, *([1] * (series.ndim - 1)))
        filtered = np.fft.irfft(np.fft.rfft(closed, axis=0) * gain, n=len(closed), axis=0)
        return np.asarray(filtered[: self.samples], dtype=float)

    def matrix(self, response: Response) -> Array:
        """The filter as a matrix (N, N): what becomes of each unit impulse."""
        return self.through(response, np.eye(self.samples))
