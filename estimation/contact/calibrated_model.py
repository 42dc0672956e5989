"""Fitted model reduced to what compensation needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.least_squares.estimates import fixed_parameters
from estimation.noise.recording_noise import NoiseSource
from estimation.streaming.streamed_fit import StreamedFit
from modeling.chain.model import WrenchModel

Array = NDArray[np.float64]

SEGMENTS_PER_RUN = 50
"""Segments of a single run whose means estimate the slow part of its residual; each averages the sensor's noise."""


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """A model, its parameters with covariance, and its noise and systematic residual where it was fitted.

    theta       (k,) in the model's order; biases are those of the first recording
    covariance  (k, k); an unidentifiable parameter has an infinite variance and zero covariances, a fixed one zeros
    floor       (p,) std of one sample, in the channels' units
    remainder   (p,) RMS of the systematic residual: the part that noise does not explain
    """

    model: WrenchModel
    theta: Array
    covariance: Array
    floor: Array
    remainder: Array

    @classmethod
    def of(cls, fitted: Fit | StreamedFit) -> Self:
        """From a fit, with the biases of its first recording and the largest systematic residual over recordings.

        Of a streamed fit it is the noise std times sqrt(reduced chi-square - 1).
        """
        size = len(fitted.model.parameters)
        covariance = fitted.covariance[:size, :size].copy()
        unidentifiable = ~fitted.identifiable[:size]
        covariance[unidentifiable], covariance[:, unidentifiable] = 0.0, 0.0
        covariance[unidentifiable, unidentifiable] = np.where(
            fixed_parameters(fitted.unknowns[:size])[unidentifiable], 0.0, np.inf
        )
        if isinstance(fitted, StreamedFit):
            floor = fitted.noise.floor
            systematic = floor * np.sqrt(max(fitted.misfit - 1, 0.0))
        else:
            floor = fitted.noise[0].floor
            systematic = np.max([systematic_residual_rms(fitted, i) for i in range(len(fitted.recordings))], axis=0)
        return cls(fitted.model, fitted.theta[:size], covariance, floor, systematic)

    @property
    def without_recording_specific(self) -> CalibratedModel:
        """The same without recording-specific effects."""
        model = self.model.without_recording_specific
        place = {p.name: i for i, p in enumerate(self.model.parameters)}
        index = np.array([place[p.name] for p in model.parameters], dtype=np.intp)
        return CalibratedModel(
            model, self.theta[index], self.covariance[np.ix_(index, index)], self.floor, self.remainder
        )

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which parameters (k,) were identifiable."""
        return np.isfinite(np.diag(self.covariance))


def systematic_residual_rms(fitted: Fit, number: int) -> Array:
    """RMS (p,) of a fit's systematic residual in one of its recordings.

    The mean over R repeats has the variance s² + n²/R for systematic part s and noise of variance n² (PHYSICS.md,
    erratum 6). Of a single run it is the RMS of the means of its segments, of static poses that of the residual
    itself: there model error and noise are not distinguishable, and this bound is conservative.
    """
    recording, noise, residual = fitted.recordings[number], fitted.noise[number], fitted.residuals[number]
    if noise.source is NoiseSource.REPEATS:
        mean = residual.reshape(recording.repeats, -1, residual.shape[1]).mean(axis=0)
        return np.asarray(np.sqrt(np.maximum(mean.var(axis=0) - noise.floor**2 / recording.repeats, 0.0)))
    if recording.at_rest:
        return np.asarray(residual.std(axis=0))
    segments = np.array_split(residual - residual.mean(axis=0), min(SEGMENTS_PER_RUN, len(residual)))
    means = np.stack([segment.mean(axis=0) for segment in segments])
    return np.asarray(np.sqrt((means**2).mean(axis=0)))
