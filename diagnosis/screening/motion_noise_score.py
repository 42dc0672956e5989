"""Score that an effect gets from the noise of the motion alone.

The motion is measured, and its noise enters twice: in the prediction, so in the residual, and in the effect's score
columns. The two are correlated, so that an effect that is not there may have a score (errors in variables).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from diagnosis.screening.null_model import NullModel
from diagnosis.screening.screening_cache import ScreeningCache
from estimation.fit import Fit
from estimation.recordings.recording import Recording, with_readings

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
        """Of a fit; None where no recording's motion is noisy."""
        noisy = tuple(noise.motion is not None for noise in fit.noise)
        if not any(noisy):
            return None
        cache = ScreeningCache() if cache is None else cache
        motions = cache.motions((fit.recordings, noisy), lambda: _drawn_motions(fit.recordings, noisy))
        return cls(tuple(_at_motion(fit, motion) for motion in motions), cache.in_other_noise())

    @cached_property
    def largest_power(self) -> float:
        """Upper limit of any score: the whitened chi-square of the residual itself."""
        residuals = (NullModel.of(fit, self.cache).residual for fit in self.fits)
        return max(float(rows @ rows) for rows in residuals)


def _drawn_motions(recordings: Sequence[Recording], noisy: Sequence[bool]) -> list[tuple[Recording, ...]]:
    """DRAWS times the recordings, those whose motion is noisy with another one."""
    rng, drawn = np.random.default_rng(0), []
    for recording in recordings:
        recording.signals  # noqa: B018  motions are drawn from the splines of its signals
    for _ in range(DRAWS):
        drawn.append(tuple(r.drawn_motions(rng, 1) if n else r for r, n in zip(recordings, noisy, strict=True)))
    return drawn


def _at_motion(fit: Fit, motion: Sequence[Recording]) -> Fit:
    """The fit to what it predicts for its own recordings, as readings at another motion."""
    readings = [fit.predicted_readings(number) for number in range(len(fit.recordings))]
    return replace(fit, recordings=tuple(with_readings(r, w) for r, w in zip(motion, readings, strict=True)))
