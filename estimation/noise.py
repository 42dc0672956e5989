"""The noise of a recording: its floor per channel, where that is known from, and how to whiten with it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from estimation.recording import Recording
from estimation.source import NoiseSource as NoiseSource
from estimation.spectrum import Spectrum
from estimation.whitening import Whitener

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of one recording.

    floor     std of one sample per channel, in its unit
    whitener  the map to rows of unit variance
    source    what it was estimated from
    doubt     per whitened row, the variance of the logarithm of the noise power it was divided by
    spectra   per channel the power spectrum per line (repeats only), S of one sample: white noise has S = std²
    events    intervals (s) found to differ from the other repeats, left out of the spectrum
    frequency Hz of each line of a line whitener, in its order
    tones     Hz of the sinusoids that were seen beside the motion and left out of the spectrum, the loudest first
    """

    floor: Array
    whitener: Whitener
    source: NoiseSource
    doubt: Array
    spectra: tuple[Spectrum, ...] = ()
    events: tuple[tuple[float, float], ...] = ()
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    tones: tuple[float, ...] = ()

    def readings(self, recording: Recording) -> Array:
        """Whitened readings (rows,) of the recording that this is the noise of, transformed once."""
        known = self._readings.get(recording)
        if known is None:
            known = self._readings[recording] = self.whitener.series(recording.wrench)
        return known

    def __getstate__(self) -> dict[str, object]:
        """The fields alone: what was computed from them is computed again."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def _readings(self) -> WeakKeyDictionary[Recording, Array]:
        return WeakKeyDictionary()

    def doubt_of(self, shares: Array) -> Array:
        """Variance (g,) of the logarithm of sums of squared rows, whose parts come from each row by `shares` (rows, g).

        To first order the logarithm of such a sum moves by the shares times the logarithms of the noise's power. Those
        belong together along a channel's curve and not from channel to channel.
        """
        if len(self.doubt) != 2 * len(self.frequency) * len(self.spectra) or not self.spectra:
            return np.asarray(self.doubt @ shares)
        lines = shares.reshape(len(self.frequency), 2, len(self.spectra), -1).sum(axis=1)
        curves = zip(self.spectra, self._bases, strict=True)
        return np.asarray(sum(s.joint_doubt_at(basis, lines[:, c]) for c, (s, basis) in enumerate(curves)))

    @cached_property
    def _bases(self) -> tuple[Array, ...]:
        """Each spectrum's basis functions at the lines."""
        return tuple(s.basis(self.frequency) for s in self.spectra)


def step_of(recording: Recording) -> float:
    """Step of the clock in s; 1 for poses at rest, which have none."""
    return recording.dt if recording.dt is not None else 1.0


def stated_floor(recording: Recording) -> Array | None:
    """Std of one sample per channel (p,) as the rig states it, None when it does not for every channel."""
    stated = recording.rig.sensor.noise if recording.rig is not None else None
    if stated is None or not all(stated.get(channel) for channel in recording.channels):
        return None
    return np.array([stated[channel] for channel in recording.channels])


def repeat_floor(recording: Recording) -> Array:
    """Std of one sample of one repeat about the mean over repeats, (p,), with R - 1 degrees of freedom."""
    repeats, once = recording.repeats, recording.samples_per_repeat
    blocks = recording.wrench.reshape(repeats, once, -1)
    return np.asarray(np.sqrt(((blocks - blocks.mean(0)) ** 2).sum((0, 1)) / (once * (repeats - 1))))
