"""Sensitivities along random trajectories: identifiability on any trajectory, noise-equivalent parameter sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from design.information.experiment import Experiment
from design.trajectories.random_periodic import random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError
from modeling.identifiability import ScaledSVD, UnidentifiableDirection, unidentifiable_directions
from modeling.rig.rig import Limits

Array = NDArray[np.float64]

RANDOM_TRAJECTORIES, RANDOM_SAMPLES = 4, 64
"""768 readings of three channels: many times the parameters of a model."""
RANDOM_PERIOD = 5.0
"""Seconds: with velocities of some rad/s an arm traverses its range in it."""
DEFAULT_LIMITS = (2.0, 2.0, 10.0)
"""rad, rad/s and rad/s², large enough to excite every parameter, for an arm whose limits are not known."""


def random_sensitivities(experiment: Experiment, limits: Limits | None, seed: int) -> Array:
    """Weighted sensitivities (R, k) along some random trajectories of all joints, within the limits where known."""
    motions = [_motion(experiment.joints, limits, (seed, number)) for number in range(RANDOM_TRAJECTORIES)]
    time = motions[0].series.instants(RANDOM_SAMPLES)
    return np.concatenate(
        [experiment.columns(*m.evaluate(time), RANDOM_PERIOD).reshape(-1, experiment.size) for m in motions]
    )


def unidentifiable_combinations(
    experiment: Experiment, limits: Limits | None = None, *, seed: int = 0
) -> tuple[UnidentifiableDirection, ...]:
    """A sparse basis of the null space of the sensitivities over all trajectories of the arm.

    Where the sensitivities are analytic in the trajectory, random trajectories have the largest rank of all (almost
    surely).
    """
    root = np.asarray(np.linalg.qr(random_sensitivities(experiment, limits, seed), mode="r"))
    return unidentifiable_directions(ScaledSVD.of(root), experiment.parameters, "any trajectory of this arm")


def noise_equivalent_sizes(experiment: Experiment, limits: Limits | None = None, *, seed: int = 0) -> Array:
    """The size (k,) of each parameter, in its unit, whose contribution to the readings equals their noise.

    In RMS over samples and channels along random trajectories of the arm; without noise, 1 in SI. As scale of the
    criteria A and E it makes them independent of the units of the parameters. Raises InputError for an unidentifiable
    parameter.
    """
    size = np.sqrt((random_sensitivities(experiment, limits, seed) ** 2).mean(axis=0))
    if not size.all():
        raise InputError(
            what=f"{experiment.parameters[int(np.argmin(size))].name} changes no reading",
            where="experiment",
            remedy="leave it out of the model, or give its effect an amplitude above zero",
        )
    return np.asarray(1 / size, dtype=float)


def _motion(joints: int, limits: Limits | None, seed: tuple[int, int]) -> Trajectory:
    if limits is None:
        position, velocity, acceleration = (np.full(joints, value) for value in DEFAULT_LIMITS)
    else:
        position = limits.position
        velocity, acceleration = (np.abs(pairs).min(axis=1) for pairs in (limits.velocity, limits.acceleration))
    return random_periodic_trajectory(
        joints=joints, position=position, velocity=velocity, acceleration=acceleration, period=RANDOM_PERIOD, seed=seed
    )
