"""Held out: a recording of another motion, never fitted, with what passed over it alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from diagnosis.part import between
from diagnosis.renewal import left_by
from diagnosis.validation import transferred
from estimation.fit import Fit
from estimation.noise import Noise, NoiseSource
from estimation.noise_source import noise_of
from estimation.recording import Recording
from modeling.effect import Effect, Values


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A recording that was not used for the fit, with its noise.

    own    effects that belong to this recording alone: its drift, a push
    start  their parameters, from which to estimate them again
    """

    recording: Recording
    noise: Noise
    own: tuple[Effect, ...] = ()
    start: Values = field(default_factory=dict)
    _carried: dict[Fit, Fit] = field(default_factory=dict, init=False, repr=False)

    def carried(self, fit: Fit) -> Fit:
        """The fit carried over to this recording, its biases and its own effects estimated here."""
        if fit not in self._carried:
            self._carried[fit] = transferred(fit, self.recording, self.noise, self.own, self.start)
        return self._carried[fit]

    @property
    def decides(self) -> bool:
        """Whether it shows what passes apart from what repeats, or a push was noticed in it."""
        return between(self.noise) is not None or bool(self.noise.events)

    def passing(self, fit: Fit) -> Fit:
        """The fit carried over to this recording, seen only where nothing that repeats is seen, if there is such."""
        return replace(self.carried(fit), noise=(between(self.noise) or self.noise,))

    def refreshed(self, fit: Fit) -> HeldOut:
        """Its own effects estimated given a fit, and its noise without them."""
        carried = self.carried(fit)
        start = {p.name: carried.values[p.name] for e in self.own for p in e.qualified(fit.model.space)}
        repeats = self.noise.source is NoiseSource.REPEATS
        noise = noise_of(self.recording, left_by(carried, 0)) if repeats else self.noise
        return replace(self, noise=noise, start=start)
