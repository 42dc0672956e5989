"""Score that an effect gets from the noise of the motion alone.

The motion is measured, and its noise enters twice: in the prediction, so in the residual, and in the effect's score
columns. The two are correlated, so that an effect that is not there may have a score (errors in variables).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from diagnosis.screening.null_model import NullModel
from diagnosis.screening.screening_cache import ScreeningCache
from estimation.fit import Fit

DRAWS = 4
"""Of the motion: the largest of as many scores bounds that of the motion's noise."""


@dataclass(frozen=True, eq=False)
class DrawnMotion:
    """Fits to what a model predicts, at motions drawn at random from what the recordings' samples leave open.

    Their residual is the noise of the motion alone. `cache` is that of their score tests.
    """

    fits: tuple[Fit, ...]
    cache: ScreeningCache = field(default_factory=ScreeningCache)

    @classmethod
    def of(cls, fit: Fit, cache: ScreeningCache | None = None) -> DrawnMotion | None:
        """Of a fit; None where no recording's motion is noisy.

        The workers of the `cache` share out the score tests of all fits: each must screen the same fits in one order.
        """
        if all(noise.motion is None for noise in fit.noise):
            return None
        rng = np.random.default_rng(0)
        fits = tuple(_at_drawn_motion(fit, rng) for _ in range(DRAWS))
        return cls(fits, ScreeningCache() if cache is None else cache.in_other_noise())

    @cached_property
    def largest_power(self) -> float:
        """Upper limit of any score: the whitened chi-square of the residual itself."""
        powers = (NullModel.of(fit, self.cache).residual for fit in self.fits)
        return max(float(rows @ rows) for rows in powers)


def _at_drawn_motion(fit: Fit, rng: np.random.Generator) -> Fit:
    drawn = []
    for number, (recording, noise) in enumerate(zip(fit.recordings, fit.noise, strict=True)):
        predicted = replace(recording, wrench=fit.predicted_readings(number))
        predicted.derivatives.update(recording.derivatives)
        drawn.append(predicted if noise.motion is None else predicted.drawn_motions(rng, 1))
    return replace(fit, recordings=tuple(drawn))
