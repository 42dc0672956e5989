"""Noise of a recording without repeats: autoregression of the residual, order by Akaike's criterion.

Such an estimate cannot test the size of that same residual.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.noise.autoregression import fit_autoregression
from estimation.noise.disturbances.transient_windows import inside, samples_of
from estimation.noise.recording_noise import NoiseSource, RecordingNoise, sample_step
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from modeling.noise.autoregressive_noise import NoiseModel
from modeling.noise.whitening import block_means

Array = NDArray[np.float64]

MAX_BLOCKS = 1000
"""Blocks that a run is averaged into: enough for the bandwidth of a tool's motion, few enough for many refits."""


def noise_from_residual(
    recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]
) -> RecordingNoise:
    """Static poses: the std of each channel's residual. A run: an autoregression per channel, joint innovations.

    The residual of static poses is model error more than noise; taking its correlation between the channels for
    noise would let one channel's error bias what another has measured, so that correlations are left out. Within
    events (s) a run has a noise of its own: the residual's variance there about its mean, and its correlation time.
    """
    block = 1 if recording.at_rest else max(1, len(residual) // MAX_BLOCKS)
    floor = _floor(recording, residual, fitted, events)
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
    whitener = AutoregressiveWhitener(recording.samples, noise, tuple(ranges), event_noise)
    parameters = noise.coefficients.size + p * (p + 1) / 2
    log_power_variance = np.full(whitener.rows, 2 * parameters / (n * p))
    return RecordingNoise(floor, whitener, NoiseSource.RESIDUAL, log_power_variance, events=events)


def _floor(recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]) -> Array:
    """Std of one sample (p,) outside events."""
    ranges = [samples_of(event, sample_step(recording), len(residual)) for event in events]
    event_free = ~inside(ranges, len(residual))
    floor = np.sqrt((residual[event_free] ** 2).sum(axis=0) / max(1.0, event_free.sum() - fitted / residual.shape[1]))
    return np.asarray(np.maximum(floor, 1e-12 * max(floor.max(), 1e-300)))


def _white_equivalent_std(in_events: Array, floor: Array) -> Array:
    """Std of a sample of white noise whose mean varies as much as that of this first-order correlated noise."""
    spread = np.maximum(in_events.std(axis=0), floor)
    correlation = (in_events[1:] * in_events[:-1]).mean(axis=0) / np.maximum(in_events.var(axis=0), 1e-300)
    correlation = np.clip(correlation, 0.0, 1 - 4 / len(in_events))
    return np.asarray(spread * np.sqrt((1 + correlation) / (1 - correlation)))
