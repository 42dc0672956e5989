"""Noise of a recording from its repeats, the rig's stated std, or the residual of a fit, in that order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from estimation.noise.disturbances.transient_windows import inside, samples_of
from estimation.noise.motion_noise import MotionNoise
from estimation.noise.noise_from_repeats import noise_from_repeats
from estimation.noise.recording_noise import (
    NoiseSource,
    RecordingNoise,
    repeat_noise_floor,
    sample_step,
    stated_noise_floor,
)
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import NO_REPEATS, largest_deviation
from modeling.errors import InputError
from modeling.noise.autoregressive_noise import NoiseModel
from modeling.noise.channel_whitening import block_means

Array = NDArray[np.float64]


NEGLIGIBLE_POWER = 0.01
"""Of the motion's noise over the stated one where its spectrum is largest: less changes no estimate."""
MAX_BLOCKS = 1000
"""Blocks that a run is averaged into: enough for the bandwidth of a tool's motion, few enough for many refits."""


def estimate_noise(
    recording: Recording,
    residual: Array,
    fitted: int = 0,
    events: tuple[tuple[float, float], ...] = (),
    motion: MotionNoise | None = None,
) -> RecordingNoise:
    """Noise of a recording from the residual (n, p) of any model of its periodic part.

    With repeats the residual's periodic part does not matter: the spectrum comes from the non-excited lines (or from
    differences of separate runs). Without, it is the std that the rig states per channel if it does, else an
    autoregression fitted to the residual, which then cannot test the size of that residual; `fitted` is the number of
    parameters behind it, `events` are intervals (s) of a run with noise of their own. To a stated std the noise of the
    `motion` of a run is added, with its colour; a residual has it in itself, and only where the motion is less certain
    than usual its rows weigh less.
    """
    if recording.repeats > 1:
        _require_one_motion(recording)
        _require_nonzero_noise(recording)
        return noise_from_repeats(recording, residual)
    stated = stated_noise_floor(recording)
    if stated is not None:
        return _noise_of_rig(stated, residual, events, motion)
    return _noise_from_residual(recording, residual, fitted, events, motion)


def _noise_of_rig(
    stated: Array, residual: Array, events: tuple[tuple[float, float], ...], motion: MotionNoise | None
) -> RecordingNoise:
    """The stated std (p,) as white noise, and the noise of the motion with its colour.

    That is the autoregression of both: of draws of the motion's errors, each with white noise of the stated std.
    """
    if motion is None:
        whitener = AutoregressiveWhitener(len(residual), NoiseModel.white(stated))
        return RecordingNoise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events)
    drawn = np.concatenate(list(motion.errors))
    floor = np.sqrt(stated**2 + np.median(motion.variance, axis=0))
    noise = NoiseModel.white(stated)
    if np.max(drawn.var(axis=0) * motion.correlation_length / stated**2) > NEGLIGIBLE_POWER:
        white = np.random.default_rng(0).standard_normal(drawn.shape) * stated
        usual = np.tile(motion.is_usual, len(motion.errors))
        noise = replace(fit_autoregression(drawn + white, usual), source=NoiseSource.RIG)
    whitener = AutoregressiveWhitener(len(residual), noise, weights=motion.weights(floor, 1))
    return RecordingNoise(floor, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events, motion=motion)


def _require_one_motion(recording: Recording) -> None:
    """Raise InputError where a repeat is none: of another motion, out of phase, with a pause, or cut wrongly."""
    found = None if recording.dt is None else largest_deviation(recording.columns, recording.repeats)
    if found is None or recording.dt is None or not found.gross:
        return
    what = f"the motion of repeat {found.repeat}, counted from 0, {found.sentence(recording.dt)}"
    raise InputError(what=what, where=recording.name, remedy=NO_REPEATS)


def _require_nonzero_noise(recording: Recording) -> None:
    """Raise InputError for channels that are identical in every repeat."""
    largest = np.abs(recording.wrench).max(axis=0)
    floor = repeat_noise_floor(recording)
    noiseless = [
        c for c, f, size in zip(recording.channels, floor, largest, strict=True) if f <= 1e-9 * size or size == 0
    ]
    if noiseless:
        raise InputError(
            what=f"{', '.join(noiseless)} is identical in every repeat, so that no noise can be estimated",
            where=recording.name,
            remedy="record the raw sensor, or leave `repeat` out and state the noise under [sensor] in the rig",
        )


def _noise_from_residual(
    recording: Recording,
    residual: Array,
    fitted: int,
    events: tuple[tuple[float, float], ...],
    motion: MotionNoise | None,
) -> RecordingNoise:
    """Static poses: the std of each channel's residual. A run: an autoregression per channel, joint innovations.

    Such an estimate cannot test the size of that same residual.
    The residual of static poses is model error more than noise; taking its correlation between the channels for
    noise would let one channel's error bias what another has measured, so that correlations are left out. Within
    events (s) a run has a noise of its own: the residual's variance there about its mean, and its correlation time.
    """
    block = 1 if recording.at_rest else max(1, len(residual) // MAX_BLOCKS)
    floor = residual_floor(recording, residual, fitted, events)
    residual = block_means(residual, block)
    n, p = residual.shape
    ranges = [samples_of(event, sample_step(recording) * block, n) for event in events]
    if recording.at_rest:
        noise = NoiseModel.white(floor)
    else:
        noise = replace(fit_autoregression(residual, ~inside(ranges, n)), block=block)
    in_events = np.concatenate(
        [residual[start:end] - residual[start:end].mean(axis=0) for start, end in ranges] or [residual]
    )
    event_noise = NoiseModel.white(_white_equivalent_std(in_events, floor))
    weights = None if motion is None else motion.weights(floor, block)
    whitener = AutoregressiveWhitener(recording.samples, noise, tuple(ranges), event_noise, weights)
    parameters = noise.coefficients.size + p * (p + 1) / 2
    log_power_variance = np.full(whitener.rows, 2 * parameters / (n * p))
    return RecordingNoise(floor, whitener, NoiseSource.RESIDUAL, log_power_variance, events=events, motion=motion)


def residual_floor(
    recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]
) -> Array:
    """Std of one sample (p,) of the residual of a model of so many parameters, outside events."""
    ranges = [samples_of(event, sample_step(recording), len(residual)) for event in events]
    event_free = ~inside(ranges, len(residual))
    floor = np.sqrt((residual[event_free] ** 2).sum(axis=0) / max(1.0, event_free.sum() - fitted / residual.shape[1]))
    return np.asarray(np.maximum(floor, 1e-12 * max(floor.max(), 1e-300)))


def with_floor_of(noise: RecordingNoise, recording: Recording, residual: Array) -> RecordingNoise:
    """The noise, where it is taken from a residual, with the std of one sample of this one."""
    if noise.source is not NoiseSource.RESIDUAL:
        return noise
    return replace(noise, floor=residual_floor(recording, residual, 0, noise.events))


def _white_equivalent_std(in_events: Array, floor: Array) -> Array:
    """Std of a sample of white noise whose mean varies as much as that of this first-order correlated noise."""
    spread = np.maximum(in_events.std(axis=0), floor)
    correlation = (in_events[1:] * in_events[:-1]).mean(axis=0) / np.maximum(in_events.var(axis=0), 1e-300)
    correlation = np.clip(correlation, 0.0, 1 - 4 / len(in_events))
    return np.asarray(spread * np.sqrt((1 + correlation) / (1 - correlation)))
