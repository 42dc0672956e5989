"""Probe: what an experiment sees along random motions, when no particular one is meant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from design.information.experiment import Experiment
from design.motion.random_motion import random_motion
from design.motion.series import Motion
from modeling.errors import InputError
from modeling.rig import Limits

Array = NDArray[np.float64]

MOTIONS, SAMPLES = 4, 64
"""768 readings of three channels: many times as many as a model has parameters."""
PERIOD = 5.0
"""Seconds: with velocities of some rad/s an arm goes through its range in it."""
LIVELY = (2.0, 2.0, 10.0)
"""rad, rad/s and rad/s² within which nothing is too small to be seen, for an arm whose limits are not known."""


def random_columns(experiment: Experiment, limits: Limits | None, seed: int) -> Array:
    """Weighted sensitivities (R, k) along some random motions of all joints, within the limits where they are known."""
    motions = [_motion(experiment.joints, limits, (seed, number)) for number in range(MOTIONS)]
    time = motions[0].series.instants(SAMPLES)
    return np.concatenate([experiment.columns(*m.evaluate(time), PERIOD).reshape(-1, experiment.size) for m in motions])


def magnitudes(experiment: Experiment, limits: Limits | None = None, *, seed: int = 0) -> Array:
    """The size (k,) of each parameter, in its unit, that alone changes the readings as much as their noise does.

    In RMS over samples and channels along random motions of the arm; without noise, by 1 in SI. As scale of the
    criteria A and E it makes them independent of the units of the parameters. Raises InputError for a parameter that no
    such motion shows.
    """
    size = np.sqrt((random_columns(experiment, limits, seed) ** 2).mean(axis=0))
    if not size.all():
        raise InputError(
            what=f"{experiment.parameters[int(np.argmin(size))].name} changes nothing that is read",
            where="experiment",
            remedy="leave it out of the model, or give its effect an amount above zero",
        )
    return np.asarray(1 / size, dtype=float)


def _motion(joints: int, limits: Limits | None, seed: tuple[int, int]) -> Motion:
    if limits is None:
        position, velocity, acceleration = (np.full(joints, value) for value in LIVELY)
    else:
        position = limits.position
        velocity, acceleration = (np.abs(pairs).min(axis=1) for pairs in (limits.velocity, limits.acceleration))
    return random_motion(
        joints=joints, position=position, velocity=velocity, acceleration=acceleration, period=PERIOD, seed=seed
    )
