"""A model's comparison with a recording, with label and colour: one column of panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from estimation.noise.recording_noise import NoiseSource, sample_step
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledComparison:
    """Comparison of one model with one recording, with label and colour."""

    label: str
    colour: str
    comparison: Comparison

    @property
    def recording(self) -> Recording:
        """The recording compared."""
        return self.comparison.recording

    @property
    def floor(self) -> Array:
        """Noise floor per channel, (p,)."""
        return np.array([self.comparison.noise_floor[c] for c in self.recording.channels])

    @property
    def noise_label(self) -> str:
        """Source of the noise floor, for legends."""
        from_residual = self.comparison.noise.source is NoiseSource.RESIDUAL
        return "noise, estimated from the residual" if from_residual else "noise of one sample"

    @property
    def measured(self) -> Array:
        """Mean over the repeats of the measured wrench, (samples of one repeat, p)."""
        return self.recording.averaged(self.recording.wrench)[: self.recording.samples_per_repeat]

    @property
    def residual(self) -> Array:
        """Mean over the repeats of measured minus predicted, (samples of one repeat, p)."""
        return self.recording.averaged(self.comparison.residual)[: self.recording.samples_per_repeat]

    @property
    def predicted(self) -> Array:
        """Mean over the repeats of the prediction, (samples of one repeat, p)."""
        return self.measured - self.residual

    @property
    def instants(self) -> Array:
        """Time in one repeat (s), or the number of each pose from 1."""
        count = np.arange(self.recording.samples_per_repeat, dtype=float)
        return count + 1 if self.recording.at_rest else count * sample_step(self.recording)


def channel_labels(sides: Sequence[LabelledComparison]) -> list[tuple[str, str]]:
    """Name and unit of each channel."""
    return list(sides[0].comparison.space.channel_units.items())
