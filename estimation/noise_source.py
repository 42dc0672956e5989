"""Where the noise of a recording is taken from: its repeats, the rig, or what a fit leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.noise import Noise, NoiseSource, repeat_floor, stated_floor
from estimation.recording import Recording
from estimation.repeat_noise import from_repeats
from estimation.residual_noise import from_residual
from estimation.whitening import RegressionWhitener
from modeling.errors import InputError

Array = NDArray[np.float64]


def noise_of(
    recording: Recording, residual: Array, fitted: int = 0, events: tuple[tuple[float, float], ...] = ()
) -> Noise:
    """Noise of a recording from the residual (n, p) of any model of what repeats.

    With repeats the residual's periodic part does not matter: the spectrum comes from the lines between those of
    the motion (or from differences of separate runs). Without, it is the std that the rig states per
    channel if it does, else an autoregression fitted to the residual, which then cannot judge that residual's size;
    `fitted` is the number of parameters that went into it, `events` are intervals (s) of a run with noise of their own.
    """
    if recording.repeats > 1:
        _require_noise(recording)
        return from_repeats(recording, residual)
    stated = stated_floor(recording)
    if stated is not None:
        whitener = RegressionWhitener(len(residual), 1, np.zeros((0, len(stated))), np.diag(1 / stated))
        return Noise(stated, whitener, NoiseSource.RIG, np.zeros(whitener.rows), events=events)
    return from_residual(recording, residual, fitted, events)


def _require_noise(recording: Recording) -> None:
    """Raise InputError for channels that read the same in every repeat."""
    largest = np.abs(recording.wrench).max(axis=0)
    floor = repeat_floor(recording)
    dead = [c for c, f, size in zip(recording.channels, floor, largest, strict=True) if f <= 1e-9 * size or size == 0]
    if dead:
        raise InputError(
            what=f"{', '.join(dead)} reads the same in every repeat, so that no noise can be measured",
            where=recording.name,
            remedy="record the raw sensor, or leave `repeat` out and state the noise under [sensor] in the rig",
        )
