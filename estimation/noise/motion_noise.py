"""Noise of the predicted wrench that comes from the measured motion: errors in variables of a single run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

DRAWN_SAMPLES = 50_000
"""Samples of all draws together."""
FEWEST_DRAWS, MOST_DRAWS = 4, 16
NEGLIGIBLE = 0.99
"""Of a weight: a smaller change changes no estimate."""
WINDOW = 5
"""Samples over which the variance of a few draws is averaged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionNoise:
    """Errors of the predicted readings by what the samples of the motion leave open.

    errors              (draws, n, p), at random from the posterior of the smoothed motion
    correlation_length  samples over which an error lasts: half the sampling rate over the smoothing's cutoff
    """

    errors: Array
    correlation_length: float

    @classmethod
    def of(cls, recording: Recording, predicted: Callable[[Recording], Array]) -> MotionNoise | None:
        """Of a run whose motion is smoothed, by a prediction (n, p) of its readings; None for any other.

        The smoothed motion is a Gaussian process with known covariance. Each draw from it goes through the kinematics
        and the tool's equations as the motion itself does, so that velocity and acceleration enter with their own
        errors and their correlation, larger at the ends of the record. Each sample is predicted by itself.
        """
        splines = [d.spline for d in recording.derivatives.values() if d.spline is not None]
        if recording.repeats > 1 or not splines:
            return None
        draws = int(np.clip(DRAWN_SAMPLES // recording.samples, FEWEST_DRAWS, MOST_DRAWS))
        drawn = recording.drawn_motions(np.random.default_rng(0), draws)
        errors = predicted(drawn).reshape(draws, recording.samples, -1) - predicted(recording)
        length = max(spline.half_rate / spline.cutoff * recording.samples / spline.samples for spline in splines)
        return cls(errors=errors, correlation_length=max(1.0, length))

    @property
    def variance(self) -> Array:
        """Variance (n, p) of each sample, averaged over `WINDOW` of them."""
        padded = np.pad(np.mean(self.errors**2, axis=0), ((WINDOW // 2, (WINDOW - 1) // 2), (0, 0)), mode="edge")
        weights = np.full(WINDOW, 1 / WINDOW)
        return np.stack([np.convolve(channel, weights, mode="valid") for channel in padded.T], axis=1)

    @property
    def is_usual(self) -> NDArray[np.bool_]:
        """Where (n,) no channel's variance is more than four times its median."""
        return np.asarray(np.all(self.variance <= 4 * np.median(self.variance, axis=0), axis=1))

    def weights(self, floor: Array, block: int) -> Array | None:
        """Factor (blocks,) of whitened rows where the motion is less certain than usual; None where it is nowhere.

        `floor` (p,) is the std of one sample of all other noise with the usual noise of the motion. An error that
        lasts for L samples counts L times its variance: as much as white noise of the same low-frequency power.
        """
        variance = self.variance
        excess = np.maximum(variance - np.median(variance, axis=0), 0.0) * self.correlation_length
        blocks = excess[: len(excess) // block * block].reshape(-1, block, excess.shape[1]).mean(axis=1)
        weights: Array = np.sqrt(1 / (1 + np.max(blocks / floor**2, axis=1)))
        return weights if weights.min() < NEGLIGIBLE else None
