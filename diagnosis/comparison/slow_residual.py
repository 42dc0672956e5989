"""Slow residual of a single run: too slow to tell a drift of the zero from physics, or either from noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from diagnosis.comparison.comparison import Comparison
from estimation.distributions import chi_square_p_value
from estimation.noise.recording_noise import NoiseSource
from modeling.number_format import format_number
from modeling.significance import LEVELS

Array = NDArray[np.float64]

SLOW_MODES = 4
"""Cosines of half a period to two periods a record: what a quarter of the record, or less, has about one value of."""
REFERENCE_MODES = slice(9, 80)
"""Cosines, counted from 0, whose level is that of the noise: ten times as fast as the slow ones."""
STEEPEST_NOISE = -1.0
"""Exponent of the frequency in a power spectral density of noise: 1/f."""
LOG_CHI_SQUARE_MEAN, LOG_CHI_SQUARE_VARIANCE = -1.2704, 4.9348
"""Of the logarithm of a chi-square variable of one degree of freedom: digamma(1/2) + log 2, trigamma(1/2)."""


@dataclass(frozen=True)
class SlowResidual:
    """The slow part of a single run's residual, per channel.

    rms      of the slow part, in the channel's unit
    floor    std of the residual without it
    p_value  of "its power is that of noise whose spectrum goes on to low frequencies as above them", Bonferroni
             over the channels
    """

    recording: str
    rms: Mapping[str, float]
    floor: Mapping[str, float]
    units: Mapping[str, str]
    p_value: Mapping[str, float]

    @classmethod
    def of(cls, comparison: Comparison) -> SlowResidual | None:
        """The slow part; None with repeats, which show it by themselves, of static poses, and of a short record."""
        recording, residual = comparison.recording, comparison.residual
        short = len(residual) < 4 * REFERENCE_MODES.stop
        if comparison.noise.source is NoiseSource.REPEATS or recording.at_rest or short:
            return None
        return cls.of_residual(recording.name, residual, comparison.space.channel_units)

    @classmethod
    def of_residual(cls, recording: str, residual: Array, units: Mapping[str, str]) -> SlowResidual:
        """The slow part of a residual (n, p), whose channels have these units by name."""
        modes = dct(residual, axis=0, norm="ortho")[1:]
        slow = (modes[:SLOW_MODES] ** 2).sum(axis=0) / len(residual)
        rest = np.maximum((residual - residual.mean(axis=0)).var(axis=0) - slow, 0.0)
        p_values = [min(1.0, len(units) * _p_value(column)) for column in (modes[: REFERENCE_MODES.stop] ** 2).T]
        by_channel = (
            dict(zip(units, v, strict=True)) for v in (np.sqrt(slow).tolist(), np.sqrt(rest).tolist(), p_values)
        )
        rms, floor, p_value = by_channel
        return cls(recording, rms, floor, units, p_value)

    @property
    def significant(self) -> tuple[str, ...]:
        """Channels whose slow part is more than the noise's own spectrum lets expect."""
        return tuple(c for c, p in self.p_value.items() if p < LEVELS.effect)

    @property
    def above_noise(self) -> tuple[str, ...]:
        """Of these the channels in which it exceeds the noise floor: a misfit, whatever its cause."""
        return tuple(c for c in self.significant if self.rms[c] > self.floor[c])

    def to_data(self) -> dict[str, Any]:
        """Plain data."""
        sizes = {"rms": dict(self.rms), "noise_floor": dict(self.floor)}
        return {
            "recording": self.recording,
            "channels": list(self.significant),
            **sizes,
            "misfit": bool(self.above_noise),
        }

    @property
    def sentence(self) -> str:
        """What remains, and what would decide its cause; empty when nothing significant does."""
        channels = self.above_noise or self.significant
        if not channels:
            return ""
        sizes = [f"{c} {format_number(self.rms[c], 2)} {self.units[c]} rms" for c in channels]
        floors = [f"{format_number(self.floor[c], 2)}" for c in channels]
        return (
            f"a slow change remains on {self.recording}: {', '.join(sizes)} (noise floor {', '.join(floors)}): drift of"
            " the zero or slow physics; repeats of the motion, or the same pose at rest before and after, tell which"
        )


def slow_residuals(comparisons: Sequence[Comparison]) -> tuple[SlowResidual, ...]:
    """The significant slow residuals of the recordings."""
    found = (SlowResidual.of(comparison) for comparison in comparisons)
    return tuple(slow for slow in found if slow is not None and slow.significant)


def _p_value(power: Array) -> float:
    """P-value of the slow modes' power (modes,), given the level of the modes above.

    Their expectation goes on from that level as 1/f: sensors have white and 1/f noise, and what rises faster towards
    low frequencies wanders. In white noise, and below the corner of an autoregression, the test is conservative.
    """
    number = np.log(np.arange(1, len(power) + 1))
    slow, above = number[:SLOW_MODES], number[REFERENCE_MODES]
    logs = np.log(np.maximum(power[REFERENCE_MODES], 1e-300)) - LOG_CHI_SQUARE_MEAN
    expected = np.exp(logs.mean() + STEEPEST_NOISE * (slow - above.mean()))
    return chi_square_p_value(
        float((power[:SLOW_MODES] / expected).sum()), SLOW_MODES, LOG_CHI_SQUARE_VARIANCE / len(above)
    )
