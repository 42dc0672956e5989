"""Hidden effects of the sensor and of its bias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from truewrench.simulated_rig.hidden_effect import (
    BiasEffect,
    HiddenEffect,
    SampleConditions,
    SensorEffect,
    SensorSignal,
)
from truewrench.simulated_rig.mujoco_scene import Array

# Sensor noise models and warm-up.


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


@dataclass(frozen=True, kw_only=True)
class SensorGain(SensorEffect):
    """Each channel named reads (1 + error) times the true value; errors as (channel, error)."""

    id = "sensor_gain"
    order = 0
    errors: tuple[tuple[str, float], ...] = (("fy", 0.03),)

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Scale channels."""
        errors = dict(self.errors)
        _require_channels(self, errors, signal.channels)
        gains = np.array([1 + errors.get(c, 0.0) for c in signal.channels])
        return signal.mapped(lambda wrench: wrench * gains)


@dataclass(frozen=True, kw_only=True)
class SensorCrosstalk(SensorEffect):
    """Crosstalk: (into, out_of, gain) adds gain times the true channel `out_of` to the reading `into`."""

    id = "sensor_crosstalk"
    order = 1
    leaks: tuple[tuple[str, str, float], ...] = (("fy", "fx", 0.04),)

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Mix channels."""
        names = signal.channels
        _require_channels(self, (name for leak in self.leaks for name in leak[:2]), names)
        matrix = np.eye(len(names))
        for into, out_of, gain in self.leaks:
            matrix[names.index(into), names.index(out_of)] += gain
        return signal.mapped(lambda wrench: wrench @ matrix.T)


@dataclass(frozen=True, kw_only=True)
class GainNonlinearity(SensorEffect):
    """Each force channel reads w + quadratic w² + cubic w³: 1/N and 1/N²."""

    id = "gain_nonlinearity"
    order = 2
    quadratic: float = 1.5e-3
    cubic: float = 0.0

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Apply the polynomial to the forces."""
        square, cube = signal.amounts(self.quadratic, 0.0), signal.amounts(self.cubic, 0.0)
        return signal.mapped(lambda w: w + square * w**2 + cube * w**3)


@dataclass(frozen=True, kw_only=True)
class SensorHysteresis(SensorEffect):
    """Play operator between load and reading, of half-width `force` (N) and `torque` (N m) in the channels.

    The reading follows the load only when the load reaches an end of the play. The record begins in the periodic state;
    with a `start` from -1 to 1, as many half-widths off the load.
    """

    id = "sensor_hysteresis"
    order = 3
    has_memory = True
    force: float = 0.25
    torque: float = 0.01
    start: float | None = None

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Play operator over the preceding period, to its periodic state, then over the record."""
        width = signal.amounts(self.force, self.torque)
        settled = _play(signal.before, width, signal.before[0])
        before = _play(signal.before, width, settled[-1])
        first = before[-1] if self.start is None else signal.record[0] + self.start * width
        return replace(signal, before=before, record=_play(signal.record, width, first))


@dataclass(frozen=True, kw_only=True)
class SensorLag(SensorEffect):
    """A first-order low-pass, time_constant dy/dt = wrench - y (s), starting in its periodic steady state.

    Exact for a wrench that is linear between the points of the oversampled grid.
    """

    id = "sensor_lag"
    order = 4
    has_memory = True
    needs_motion = True
    time_constant: float = 0.02

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Filter the preceding period, then the record.

        Over one step h the input goes from u to v and y becomes a y + old u + new v, with a = exp(-h / T),
        new = 1 - (1 - a) T / h, old = 1 - a - new. The periodic state repeats after the period's steps.
        """
        share = signal.step / self.time_constant
        pole = np.exp(-share)
        new = 1 - (1 - pole) / share
        old = (1 - pole) - new
        b, a = [new, old], [1.0, -pole]
        start = np.zeros((1, signal.before.shape[1]))
        free = lfilter(b, a, signal.before, axis=0, zi=start)[0]
        ends = free[-1] * pole + old * signal.before[-1]
        state = (ends / (1 - pole ** len(free)))[None, :]
        before, after = lfilter(b, a, signal.before, axis=0, zi=state)
        record, _ = lfilter(b, a, signal.record, axis=0, zi=after)
        return replace(signal, before=before, record=record)


@dataclass(frozen=True, kw_only=True)
class TimeDelay(HiddenEffect):
    """The reading at time t is that of the motion at t - delay (s)."""

    id = "time_delay"
    needs_motion = True
    delay: float = 0.012


@dataclass(frozen=True, kw_only=True)
class Saturation(HiddenEffect):
    """Each force channel is clipped at `share` of its own largest |reading|, before the noise is added."""

    id = "saturation"
    share: float = 0.9

    def clipped(self, readings: Array, forces: npt.NDArray[np.bool_]) -> Array:
        """The readings (N, p), clipped."""
        level = np.where(forces, self.share * np.abs(readings).max(axis=0), np.inf)
        return np.clip(readings, -level, level)


# Effects on the bias.


@dataclass(frozen=True, kw_only=True)
class BiasDrift(BiasEffect):
    """Smooth bias drift, by `force` (N) and `torque` (N m) from peak to peak.

    It is a random sum of 1 to 4 half-waves over the record.
    """

    id = "bias_drift"
    force: float = 0.6
    torque: float = 0.05

    def shift(self, conditions: SampleConditions, rng: np.random.Generator) -> Array:
        """An independent drift in each channel, starting from zero."""
        progress = (conditions.time - conditions.time[0]) / (np.ptp(conditions.time) or 1.0)
        waves = np.cos(np.pi * np.multiply.outer(progress, np.arange(1, 5)))
        drift = waves @ (rng.standard_normal((4, len(conditions.channels))) / np.arange(1, 5)[:, None])
        size = np.ptp(drift, axis=0)
        return np.asarray((drift - drift[0]) / size * conditions.amounts(self.force, self.torque))


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(BiasEffect):
    """Bias proportional to the true temperature: force (N/K) and torque (N m/K) times (temperature - 20 °C)."""

    id = "thermal_drift"
    force: float = 0.2
    torque: float = 0.01

    def shift(self, conditions: SampleConditions, rng: np.random.Generator) -> Array:
        """Proportional to the temperature."""
        return np.outer(conditions.temperature - 20.0, conditions.amounts(self.force, self.torque))


@dataclass(frozen=True, kw_only=True)
class LineInterference(BiasEffect):
    """A tone at `frequency` (Hz), not synchronous with the motion, of `force` (N) and `torque` (N m)."""

    id = "line_interference"
    needs_motion = True
    frequency: float = 17.317
    force: float = 0.2
    torque: float = 0.01

    def shift(self, conditions: SampleConditions, rng: np.random.Generator) -> Array:
        """One sine per channel."""
        phase = rng.uniform(0, 2 * np.pi, len(conditions.channels))
        angle = 2 * np.pi * self.frequency * conditions.time[:, None] + phase
        return np.asarray(conditions.amounts(self.force, self.torque) * np.sin(angle))


def _require_channels(effect: HiddenEffect, names: Iterable[str], channels: tuple[str, ...]) -> None:
    for name in names:
        if name not in channels:
            raise ValueError(f"{effect.id}: the rig has no channel '{name}'; it has {', '.join(channels)}")


def _play(load: Array, width: Array, start: Array) -> Array:
    """The play operator, by channel: y stays within `width` of the load and moves only at its limits."""
    low, high = load - width, load + width
    output = np.empty_like(load)
    y = start
    for i in range(len(load)):
        y = np.minimum(np.maximum(y, low[i]), high[i])
        output[i] = y
    return output
