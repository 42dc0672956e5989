"""Renewal: the noise of recordings estimated again, once it is known what passed over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.noise import Noise, NoiseSource
from estimation.noise_source import noise_of
from estimation.response import predicted
from modeling.effect import Effect
from modeling.space import Space

Array = NDArray[np.float64]

CHANGE = 1.1
"""Ratio of an old to a new noise's power, in any channel, from which a search is worth repeating."""


def searched_in(effect: Effect, unit: str, space: Space) -> bool:
    """Whether an effect has a nuisance parameter of that unit: "s" for what begins or ends, "Hz" for a tone."""
    return any(p.nuisance and p.unit == unit for p in effect.parameters(space))


def renewed_noise(fit: Fit) -> tuple[Noise, ...] | None:
    """The noise of a fit's recordings without the events that it explains; None where they hardly change it.

    A mass that is taken up, or a push, reaches all lines of the spectrum, and what of it was not foreseen when the
    noise was estimated was taken for noise.
    """
    if not any(searched_in(e, "s", fit.model.space) for e in fit.model.effects):
        return None
    renewed = tuple(_renewed(fit, number) for number in range(len(fit.recordings)))
    louder = [_ratio(old, new) for old, new in zip(fit.noise, renewed, strict=True)]
    return renewed if max(louder) > CHANGE else None


def _renewed(fit: Fit, number: int) -> Noise:
    """The events noticed stay noticed, though nothing is left of them."""
    before = fit.noise[number]
    if before.source is not NoiseSource.REPEATS:
        return before
    return replace(noise_of(fit.recordings[number], left_by(fit, number)), events=before.events)


def left_by(fit: Fit, number: int) -> Array:
    """What a fit leaves of a recording (n, p), tones included: noise is estimated beside them, whoever hums."""
    own = fit.layout.models[number]
    index = fit.layout.index[number]
    values = {p.name: fit.theta[i] for p, i in zip(own.parameters, index, strict=True)}
    quiet = replace(own, effects=tuple(e for e in own.effects if not searched_in(e, "Hz", own.space)))
    theta = np.array([values[p.name] for p in quiet.parameters])
    return np.asarray(fit.recordings[number].wrench - predicted(quiet, fit.recordings[number], theta))


def _ratio(old: Noise, new: Noise) -> float:
    """Largest ratio over the channels of the two noises' typical power between the motion's lines."""
    if not old.spectra or not new.spectra:
        return 1.0
    ratios = [np.median(a(new.frequency) / b(new.frequency)) for a, b in zip(old.spectra, new.spectra, strict=True)]
    return float(max(ratios))
