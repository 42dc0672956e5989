"""Side: one model's comparison with a recording, as one of the columns in which models stand side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import Comparison
from estimation.noise import NoiseSource, step_of
from estimation.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Side:
    """A model's label and colour, and its comparison with one recording."""

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
    def noise_words(self) -> str:
        """What the floor is: noise, which without repeats may be all that is left."""
        from_residual = self.comparison.noise.source is NoiseSource.RESIDUAL
        return "noise, taken from what is left" if from_residual else "noise of one sample"

    @property
    def measured(self) -> Array:
        """Mean over the repeats of what was measured, (samples of one repeat, p)."""
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
        return count + 1 if self.recording.at_rest else count * step_of(self.recording)


def channel_labels(sides: Sequence[Side]) -> list[tuple[str, str]]:
    """Name and unit of each channel."""
    first = sides[0]
    return list(zip(first.recording.channels, first.comparison.space.units, strict=True))
