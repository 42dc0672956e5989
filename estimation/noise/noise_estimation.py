"""Noise of a recording from its repeats, the rig's stated std, or the residual of a fit, in that order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.noise.noise_from_repeats import noise_from_repeats
from estimation.noise.noise_from_residual import noise_from_residual
from estimation.noise.recording_noise import NoiseSource, RecordingNoise, repeat_noise_floor, stated_noise_floor
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.noise.autoregressive_noise import NoiseModel

Array = NDArray[np.float64]


def estimate_noise(
    recording: Recording, residual: Array, fitted: int = 0, events: tuple[tuple[float, float], ...] = ()
) -> RecordingNoise:
    """Noise of a recording from the residual (n, p) of any model of its periodic part.

    With repeats the residual's periodic part does not matter: the spectrum comes from the non-excited lines (or from
    differences of separate runs). Without, it is the std that the rig states per channel if it does, else an
    autoregression fitted to the residual, which then cannot test the size of that residual; `fitted` is the number of
    parameters behind it, `events` are intervals (s) of a run with noise of their own.
    """
    if recording.repeats > 1:
        _require_nonzero_noise(recording)
        return noise_from_repeats(recording, residual)
    stated = stated_noise_floor(recording)
    if stated is not None:
        whitener = AutoregressiveWhitener(len(residual), NoiseModel.white(stated))
        return RecordingNoise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events)
    return noise_from_residual(recording, residual, fitted, events)


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
