"""Sampling: the instants at which a trajectory is sampled, and filters over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FrequencyResponse = Callable[[Array], NDArray[np.complex128]]
"""A transfer function at angular frequencies (L,) in rad/s: (L,)."""

CLOCK_SIGNALS = ("time", "progress")
"""Signals of time itself: s from the start, and -1 to 1 over the record."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """N equally spaced samples of one trajectory over `duration` (s).

    A periodic trajectory is sampled at j T / N in its steady state, after earlier periods. Another one is sampled from
    its first instant to its last, and was at rest in its first posture before.
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
        """The signals of `CLOCK_SIGNALS`, (2, N)."""
        return np.stack([self.time, np.linspace(-1.0, 1.0, self.samples)])

    def through(self, response: FrequencyResponse, series: Array) -> Array:
        """A series (N, ...) through a transfer function, by a real discrete Fourier transform.

        One period of a periodic trajectory is filtered exactly, line by line (at half the sampling rate only the real
        part). Any other series is padded by as many samples of its first value, the value before and after a
        trajectory that returns to its first posture: exact when the filter's transient has decayed after them.
        """
        padded = series if self.periodic else np.concatenate([series, np.repeat(series[:1], len(series), axis=0)])
        omega = np.asarray(2 * np.pi * np.fft.rfftfreq(len(padded), self.step), dtype=float)
        gain = response(omega).reshape(-1, *([1] * (series.ndim - 1)))
        filtered = np.fft.irfft(np.fft.rfft(padded, axis=0) * gain, n=len(padded), axis=0)
        return np.asarray(filtered[: self.samples], dtype=float)

    def matrix(self, response: FrequencyResponse) -> Array:
        """The filter as a matrix (N, N) of impulse responses."""
        return self.through(response, np.eye(self.samples))
