"""Events beside a solution: the noise without them, their shapes, and the std of their times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.problem import Solution
from estimation.least_squares.square_root_information import orthonormal_basis
from estimation.model_response import predicted_readings
from estimation.noise.noise_estimation import estimate_noise
from estimation.noise.recording_noise import RecordingNoise, sample_step
from estimation.noise.transient_windows import LONGEST_EVENT, EventShape, event_shapes
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.noise import NoiseSource
from modeling.parameter import Role

Array = NDArray[np.float64]

MIN_POWER_RATIO = 1.1
"""Ratio of old to re-estimated noise power, in any channel, above which the fit, or the search, is repeated."""


def noise_without_transients(fit: Solution) -> tuple[RecordingNoise, ...] | None:
    """Noise of a fit's recordings without the effects that it explains; None where it hardly changes.

    A payload change or a contact has a broad spectrum, and what event detection missed of it was attributed to noise.
    So was what any effect makes of repeats that moved differently, and how a play came into its steady state.
    """
    transient = any(e.has_role(Role.ONSET, fit.model.space) or e.stage is Stage.PLAY for e in fit.model.effects)
    changed = [transient or (r.own_motion is not None and bool(fit.model.effects)) for r in fit.recordings]
    if not any(changed):
        return None
    new_noise = tuple(
        replace(noise_beside_events(fit, i), events=noise.events) if new else noise
        for i, (noise, new) in enumerate(zip(fit.noise, changed, strict=True))
    )
    pairs = list(zip(fit.noise, new_noise, strict=True))
    reshaped = any(old.shapes != new.shapes for old, new in pairs)
    return new_noise if reshaped or max(starmap(_power_ratio, pairs)) > MIN_POWER_RATIO else None


def noise_beside_events(fit: Solution, number: int) -> RecordingNoise:
    """Noise of one recording of repeats, re-estimated from its residual; any other as it is.

    Where an event is left beside a contact that the fit has, its wrench is not constant: its shape is then free. So is
    that of events elsewhere, which no effect stands for.
    """
    before, recording, residual = fit.noise[number], fit.recordings[number], residual_with_tones(fit, number)
    if before.source is not NoiseSource.REPEATS:
        return before
    after = estimate_noise(recording, residual, shapes=before.shapes)
    contact = _contact(fit, number)
    if contact is None or not after.events:
        return after
    shapes = event_shapes(before.shapes, contact, after.events, before.events, _longest_event(recording))
    return after if shapes == before.shapes else estimate_noise(recording, residual, shapes=shapes)


def noise_beside_unexplained_events(fit: Solution) -> tuple[RecordingNoise, ...] | None:
    """Noise of a fit's recordings beside events of several windows, which no effect explains; None without any.

    Their shape is free but for a mean wrench, as what is not constant may hide a contact from its own test.
    """
    noise = list(fit.noise)
    for number, (recording, before) in enumerate(zip(fit.recordings, fit.noise, strict=True)):
        if before.source is NoiseSource.REPEATS and len(before.events) > 1 and not before.shapes:
            shapes = event_shapes((), before.events[0], before.events[1:], (), _longest_event(recording))
            after = estimate_noise(recording, residual_with_tones(fit, number), shapes=shapes) if shapes else before
            noise[number] = replace(after, events=before.events)
    reshaped = any(after.shapes != before.shapes for after, before in zip(noise, fit.noise, strict=True))
    return tuple(noise) if reshaped else None


def _longest_event(recording: Recording) -> float:
    """Length (s) of the longest event of a recording."""
    return LONGEST_EVENT * recording.samples * sample_step(recording)


def _contact_times(fit: Solution, number: int) -> tuple[str, ...]:
    """Names of begin and end of the contact that a fit has in one of its recordings, empty without one."""
    model = fit.layout.models[number]
    for effect in model.effects:
        times = tuple(p.name for p in effect.qualified(model.space) if p.role is Role.ONSET)
        if len(times) == 2:
            return times
    return ()


def _contact(fit: Solution, number: int) -> tuple[float, float] | None:
    """Begin and end (s) of the contact that a fit has in one of its recordings; None without one."""
    values = _values(fit)
    times = sorted(values[name] for name in _contact_times(fit, number))
    return (times[0], times[-1]) if times else None


def values_in(noise: Sequence[RecordingNoise], fit: Solution) -> dict[str, float]:
    """Estimates of a fit, with a contact's times where the noise has its event in a shape of its own."""
    values = _values(fit)
    for number, recording_noise in enumerate(noise):
        for shape in recording_noise.shapes:
            if shape.judged:
                values |= dict(zip(_contact_times(fit, number), shape.interval, strict=False))
    return values


def _values(fit: Solution) -> dict[str, float]:
    """The value of every unknown by name."""
    return {p.name: float(value) for p, value in zip(fit.unknowns, fit.theta, strict=True)}


def _event_shape_of(fit: Solution, onset: str) -> EventShape | None:
    """The event, its shape free, of which a parameter of a fit is begin or end; None of any other."""
    for number, noise in enumerate(fit.noise):
        if onset in _contact_times(fit, number):
            return next((shape for shape in noise.shapes if shape.judged), None)
    return None


def residual_with_tones(fit: Solution, number: int) -> Array:
    """Residual (n, p) of a fit without its tone effects: noise estimation excludes tones itself."""
    model = fit.layout.models[number]
    index = fit.layout.index[number]
    values = {p.name: fit.theta[i] for p, i in zip(model.parameters, index, strict=True)}
    effects = tuple(e for e in model.effects if not e.has_role(Role.FREQUENCY, model.space))
    without_tones = replace(model, effects=effects)
    theta = np.array([values[p.name] for p in without_tones.parameters])
    return np.asarray(fit.recordings[number].wrench - predicted_readings(without_tones, fit.recordings[number], theta))


def _power_ratio(old: RecordingNoise, new: RecordingNoise) -> float:
    """Median over frequency of the ratio of the two power spectral densities; the largest over the channels."""
    if not old.spectra or not new.spectra:
        return 1.0
    ratios = [np.median(a(new.frequency) / b(new.frequency)) for a, b in zip(old.spectra, new.spectra, strict=True)]
    return float(max(ratios))


def onset_stds(fit: Solution) -> dict[int, float]:
    """Std (s) of the onset times of a fit, by their place among its unknowns; not below the sampling step.

    An edge is shorter than a sample: between samples the prediction does not change with its time, and within one it
    changes by that sample alone, so that the derivative says nothing of the std. It is the least shift by which the
    prediction, beside all other parameters, changes by one std of the noise. Of an event whose shape is free it is no
    less than the margin of that shape.
    """
    onsets = [place for place, p in enumerate(fit.unknowns) if p.role is Role.ONSET and not p.fixed]
    linearised = fit.problem.linearised(fit.theta)
    others = orthonormal_basis(np.delete(linearised.derivative, onsets, axis=1))
    step = max(sample_step(recording) for recording in fit.recordings)
    longest = step * max(recording.samples for recording in fit.recordings)

    def change(place: int, shift: float) -> float:
        """Whitened chi-square by which the prediction changes beside all other parameters, the mean of both sides."""
        total = 0.0
        for signed in (shift, -shift):
            theta = fit.theta.copy()
            theta[place] += signed
            moved = (linearised.residual - fit.problem.residual(theta))[linearised.reached]
            total += float(moved @ moved) - float(np.sum((others.T @ moved) ** 2))
        return total / 2

    stds = {}
    for place in onsets:
        shape = _event_shape_of(fit, fit.unknowns[place].name)
        least = shift = step if shape is None else max(step, shape.margin)
        while (squares := change(place, shift)) < 1.0 and shift < longest:
            shift *= 2
        stds[place] = max(least, shift / np.sqrt(max(squares, 1.0)))
    return stds
