"""Calibration: a fitted model as what it takes to subtract it from other recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.noise import NoiseSource
from estimation.stream.streaming import StreamedFit
from modeling.model import WrenchModel

Array = NDArray[np.float64]

STRETCHES = 50
"""Stretches of a single run whose means tell what is slow in its residual; each still averages the sensor's noise."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A model, its parameters with covariance, and how well it did where it was fitted.

    theta       (k,) in the model's order; biases are those of the first recording
    covariance  (k, k); a parameter that the recordings did not show has an infinite variance and no covariance
    floor       (p,) std of one sample, in the channels' units
    remainder   (p,) RMS of what the model is known to miss: the part of its residual that noise does not explain
    """

    model: WrenchModel
    theta: Array
    covariance: Array
    floor: Array
    remainder: Array

    @classmethod
    def of(cls, fitted: Fit | StreamedFit) -> Self:
        """What the fit found, with the biases of its first recording and the largest remainder of all.

        Of parts that were not kept the remainder is what the misfit adds to the noise given.
        """
        size = len(fitted.model.parameters)
        covariance = fitted.covariance[:size, :size].copy()
        unseen = ~fitted.shown[:size]
        covariance[unseen], covariance[:, unseen] = 0.0, 0.0
        covariance[unseen, unseen] = np.inf
        if isinstance(fitted, StreamedFit):
            floor = fitted.noise.floor
            left = floor * np.sqrt(max(fitted.misfit - 1, 0.0))
        else:
            floor = fitted.noise[0].floor
            left = np.max([remainder(fitted, i) for i in range(len(fitted.recordings))], axis=0)
        return cls(fitted.model, fitted.theta[:size], covariance, floor, left)

    @property
    def lasting(self) -> Calibration:
        """The same less the effects that belong to one recording."""
        model = self.model.lasting
        place = {p.name: i for i, p in enumerate(self.model.parameters)}
        kept = np.array([place[p.name] for p in model.parameters], dtype=np.intp)
        return Calibration(model, self.theta[kept], self.covariance[np.ix_(kept, kept)], self.floor, self.remainder)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which parameters (k,) were determined."""
        return np.isfinite(np.diag(self.covariance))


def remainder(fitted: Fit, number: int) -> Array:
    """RMS (p,) of what a fit leaves beyond the noise in one of its recordings.

    The mean over R repeats has the variance s² + n²/R of a remainder s and noise of variance n² (PHYSICS.md, erratum
    6). In a single run it is what is left of the means of its stretches, in poses the residual itself: there nothing
    parts the model's error from noise, and the larger answer is the safe one.
    """
    recording, noise, residual = fitted.recordings[number], fitted.noise[number], fitted.residuals[number]
    if noise.source is NoiseSource.REPEATS:
        mean = residual.reshape(recording.repeats, -1, residual.shape[1]).mean(axis=0)
        return np.asarray(np.sqrt(np.maximum(mean.var(axis=0) - noise.floor**2 / recording.repeats, 0.0)))
    if recording.at_rest:
        return np.asarray(residual.std(axis=0))
    parts = np.array_split(residual - residual.mean(axis=0), min(STRETCHES, len(residual)))
    means = np.stack([part.mean(axis=0) for part in parts])
    return np.asarray(np.sqrt((means**2).mean(axis=0)))
