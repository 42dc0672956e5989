"""Noise re-estimation after effects have been identified that are transient, or that differ between repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.model_response import predicted_readings
from estimation.noise.noise_estimation import estimate_noise
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from modeling.parameter import Role

Array = NDArray[np.float64]

MIN_POWER_RATIO = 1.1
"""Ratio of old to re-estimated noise power, in any channel, above which the search is repeated."""


def noise_without_transients(fit: Fit) -> tuple[RecordingNoise, ...] | None:
    """Noise of a fit's recordings without the effects that it explains; None where it hardly changes.

    A payload change or a contact has a broad spectrum, and what event detection missed of it was attributed to noise.
    So was what any effect makes of repeats that moved differently.
    """
    transient = any(e.has_role(Role.ONSET, fit.model.space) for e in fit.model.effects)
    changed = [transient or (r.own_motion is not None and bool(fit.model.effects)) for r in fit.recordings]
    if not any(changed):
        return None
    new_noise = tuple(_reestimated(fit, i) if new else fit.noise[i] for i, new in enumerate(changed))
    ratios = [_power_ratio(old, new) for old, new in zip(fit.noise, new_noise, strict=True)]
    return new_noise if max(ratios) > MIN_POWER_RATIO else None


def _reestimated(fit: Fit, number: int) -> RecordingNoise:
    """Noise of one recording, re-estimated; its detected events stay marked although the fit explains them."""
    before = fit.noise[number]
    if before.source is not NoiseSource.REPEATS:
        return before
    return replace(estimate_noise(fit.recordings[number], residual_with_tones(fit, number)), events=before.events)


def residual_with_tones(fit: Fit, number: int) -> Array:
    """Residual (n, p) of a fit without its tone effects: noise estimation excludes tones itself."""
    own = fit.layout.models[number]
    index = fit.layout.index[number]
    values = {p.name: fit.theta[i] for p, i in zip(own.parameters, index, strict=True)}
    without_tones = replace(own, effects=tuple(e for e in own.effects if not e.has_role(Role.FREQUENCY, own.space)))
    theta = np.array([values[p.name] for p in without_tones.parameters])
    return np.asarray(fit.recordings[number].wrench - predicted_readings(without_tones, fit.recordings[number], theta))


def _power_ratio(old: RecordingNoise, new: RecordingNoise) -> float:
    """Median over frequency of the ratio of the two power spectral densities; the largest over the channels."""
    if not old.spectra or not new.spectra:
        return 1.0
    ratios = [np.median(a(new.frequency) / b(new.frequency)) for a, b in zip(old.spectra, new.spectra, strict=True)]
    return float(max(ratios))
