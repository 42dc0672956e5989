"""Held-out recording with its noise and its recording-specific disturbances."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from diagnosis.comparison.comparison import Comparison, comparison_of
from diagnosis.comparison.data_split import non_excited_noise
from diagnosis.comparison.validation import validation_fit
from estimation.fit import Fit, residual_with_tones
from estimation.noise.noise_estimation import estimate_noise
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect, NuisanceValues


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A recording that was not used for the fit, with its noise.

    disturbances    its recording-specific disturbances: drift, contact
    start  initial values of their parameters
    """

    recording: Recording
    noise: RecordingNoise
    disturbances: tuple[Effect, ...] = ()
    start: NuisanceValues = field(default_factory=dict)
    _predictions: dict[Fit, HeldOutPrediction] = field(default_factory=dict, init=False, repr=False)

    def prediction(self, fit: Fit) -> HeldOutPrediction:
        """The prediction of this recording by a fit."""
        return self._predictions.setdefault(fit, HeldOutPrediction(self, fit))

    def validation_fit(self, fit: Fit) -> Fit:
        """Validation fit to this recording: its biases and its disturbances estimated here."""
        return self.prediction(fit).validation_fit

    @property
    def disturbances_identifiable(self) -> bool:
        """Whether disturbances are identifiable: it has non-excited lines, or a detected event."""
        return non_excited_noise(self.noise) is not None or bool(self.noise.events)

    def non_excited_fit(self, fit: Fit) -> Fit:
        """The validation fit restricted to the non-excited lines, where there are any."""
        return replace(self.validation_fit(fit), noise=(non_excited_noise(self.noise) or self.noise,))

    def reestimated(self, fit: Fit) -> HeldOut:
        """The recording with its disturbances and its noise without them re-estimated, given a fit."""
        carried = self.validation_fit(fit)
        start = {p.name: carried.values[p.name] for e in self.disturbances for p in e.qualified(fit.model.space)}
        repeats = self.noise.source is NoiseSource.REPEATS
        noise = estimate_noise(self.recording, residual_with_tones(carried, 0)) if repeats else self.noise
        return replace(self, noise=noise, start=start)


@dataclass(frozen=True, eq=False)
class HeldOutPrediction:
    """A held-out recording as a fit to other recordings predicts it."""

    held_out: HeldOut
    fit: Fit

    @cached_property
    def validation_fit(self) -> Fit:
        """The fit with the biases and the disturbances estimated on the held-out recording."""
        own = self.held_out
        return validation_fit(self.fit, own.recording, own.noise, own.disturbances, own.start)

    @cached_property
    def comparison(self) -> Comparison:
        """The recording with that prediction."""
        return comparison_of(self.validation_fit, 0)
