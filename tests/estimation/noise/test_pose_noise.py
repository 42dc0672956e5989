"""Noise of poses at rest: what depends on the pose is none, whatever the noise of the other channels is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.case import Case
from estimation.fit import Fit, in_noise_beside_pose, unchecked_fit
from estimation.noise.pose_noise import PoseNoise
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.recordings import base, recording_of
from truewrench.simulated_rig import (
    GainNonlinearity,
    GravityTilt,
    HiddenEffect,
    PlanarRig,
    SensorCrosstalk,
    SensorGain,
    SensorRotation,
    SpatialRig,
    static_poses,
)

Array = NDArray[np.float64]

SPACE, PLANE = SpatialRig(), PlanarRig()
PLANAR = Rig(link_lengths=PLANE.link_lengths, tip_length=0.2)
UNEQUAL = {Space.SPACE: np.array([0.1, 0.1, 3.0, 0.004, 0.1, 0.003]), Space.PLANE: np.array([3.0, 0.1, 0.01])}
"""Std of the channels, N and N m, of which one force has thirty times the other's."""


def posed(space: Space, count: int, seed: int, *hidden: HiddenEffect, std: Array | None = None) -> Recording:
    noise = tuple((UNEQUAL[space] if std is None else std).tolist())
    rig = replace(SPACE, noise=noise) if space is Space.SPACE else replace(PLANE, noise=noise)
    frame = static_poses(rig, count, hidden=hidden, seed=seed).drop(columns=["temperature"])
    return recording_of(frame, rig=PLANAR if space is Space.PLANE else None)


def fitted(recording: Recording) -> Fit:
    model = base(Space.SPACE) if recording.dimension == 3 else planar(PLANAR)
    return unchecked_fit(Case.of(model, [recording], as_read=True))


def noise_of(fit: Fit) -> PoseNoise:
    noise = PoseNoise.of(fit.recordings[0], fit.residuals[0])
    assert noise is not None
    return noise


@pytest.mark.parametrize("space", list(Space))
def test_noise_alone_does_not_depend_on_the_pose(space: Space) -> None:
    """Channels of thirty times the noise of others lack nothing. At one percent, 4 of 60 or more are one in 300."""
    doubted = [noise_of(fitted(posed(space, 12 + seed % 29, seed))).is_below_residual for seed in range(60)]
    assert sum(doubted) <= 3


@pytest.mark.parametrize(
    "hidden", [SensorGain(), SensorCrosstalk(), SensorRotation(), GravityTilt(), GainNonlinearity()]
)
def test_what_depends_on_the_pose_is_no_noise(hidden: HiddenEffect) -> None:
    std = np.array(SPACE.noise) / 2
    fit = fitted(posed(Space.SPACE, 40, 3, hidden, std=std))
    noise = noise_of(fit)
    assert noise.is_below_residual
    # Of 30 degrees of freedom, each of six std is within half and twice the true one but for one in a thousand.
    assert np.all((noise.std > std / 2) & (noise.std < 2 * std))
    inside = in_noise_beside_pose(fit)
    np.testing.assert_allclose(inside.noise[0].floor, noise.std, rtol=0.2)  # of the residual in the first noise


def test_a_fit_without_what_is_missing_stays_as_it_is() -> None:
    fit = fitted(posed(Space.SPACE, 24, 1))
    assert in_noise_beside_pose(fit) is fit


def test_too_few_poses_tell_nothing() -> None:
    fit = fitted(posed(Space.SPACE, 9, 1))
    assert PoseNoise.of(fit.recordings[0], fit.residuals[0]) is None
    assert in_noise_beside_pose(fit) is fit


def test_a_pose_that_does_not_belong_is_no_noise() -> None:
    recording = posed(Space.SPACE, 24, 5, std=np.array(SPACE.noise))
    readings = np.array(recording.wrench)
    readings[7, 0] += 40 * SPACE.noise[0]
    noise = noise_of(fitted(recording.with_readings(readings)))
    assert noise.is_below_residual
    assert noise.std[0] < 2 * SPACE.noise[0]
