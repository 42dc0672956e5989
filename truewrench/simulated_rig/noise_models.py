"""Sensor noise models and warm-up."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from truewrench.simulated_rig.mujoco_scene import Array


class NoiseModel(ABC):
    """Sensor noise: an independent random series of unit variance in each channel."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """The series, (samples, channels)."""


@dataclass(frozen=True, kw_only=True)
class WhiteNoise(NoiseModel):
    """Independent normal samples."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Normal."""
        return rng.standard_normal((samples, channels))


@dataclass(frozen=True, kw_only=True)
class AutoregressiveNoise(NoiseModel):
    """x_k = rho x_(k-1) + e_k, stationary from the first sample."""

    rho: float = 0.98

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Filtered normal noise that starts in its stationary distribution."""
        shocks = rng.standard_normal((samples, channels)) * np.sqrt(1 - self.rho**2)
        start = self.rho * rng.standard_normal((1, channels))
        return np.asarray(lfilter([1.0], [1.0, -self.rho], shocks, axis=0, zi=start)[0])


@dataclass(frozen=True, kw_only=True)
class PinkNoise(NoiseModel):
    """A power spectrum 1 + corner/f, and tones; frequencies relative to the sampling rate.

    The tones carry `tone_share` of the variance, in equal parts; they are not multiples of the motion's
    frequency.
    """

    corner: float = 0.02
    tones: tuple[float, ...] = (0.1312347, 0.2871113)
    tone_share: float = 0.2

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """One half of a periodic series, so that the record itself is not periodic."""
        frequency = np.fft.rfftfreq(2 * samples)
        power = 1 + self.corner / np.maximum(frequency, frequency[1])
        power[0] = 0.0
        white = np.fft.rfft(rng.standard_normal((2 * samples, channels)), axis=0)
        series = np.fft.irfft(white * np.sqrt(power / power.mean())[:, None], 2 * samples, axis=0)[:samples]
        phase = rng.uniform(0, 2 * np.pi, (len(self.tones), channels))
        angle = 2 * np.pi * np.multiply.outer(np.arange(samples), self.tones)[:, :, None] + phase
        share = self.tone_share if self.tones else 0.0
        tones = np.sqrt(2 / max(len(self.tones), 1)) * np.sin(angle).sum(axis=1)
        return np.asarray(np.sqrt(1 - share) * series + np.sqrt(share) * tones)


@dataclass(frozen=True, kw_only=True)
class StudentNoise(NoiseModel):
    """Independent samples of Student's t (heavy tails)."""

    degrees: float = 4.0

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """t of variance degrees / (degrees - 2), scaled to one."""
        heavy = rng.standard_t(self.degrees, (samples, channels))
        return np.asarray(heavy * np.sqrt(1 - 2 / self.degrees))


NOISE_MODELS: Mapping[str, NoiseModel] = {
    "white": WhiteNoise(),
    "autoregressive": AutoregressiveNoise(),
    "pink_and_lines": PinkNoise(),
    "student_t": StudentNoise(),
}
"""The noise models by name."""


@dataclass(frozen=True, kw_only=True)
class WarmUpTemperature:
    """The sensor's temperature, `start` to `end` (°C) with a time constant (s), logged with noise (°C)."""

    start: float = 22.0
    end: float = 25.0
    time_constant: float = 20.0
    noise: float = 0.05

    def true(self, time: Array) -> Array:
        """True temperature, °C."""
        return np.asarray(self.end + (self.start - self.end) * np.exp(-time / self.time_constant))
