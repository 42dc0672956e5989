"""Dwells: found by motion and readings, and the noise of their means."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.recordings.dwells import Dwells, MeanNoise
from estimation.recordings.motion import MotionForm
from modeling.rig import SPATIAL_CHANNELS
from tests.shared.dwell_logs import DwellLog, flicker

Array = NDArray[np.float64]


def dwells_of(log: DwellLog) -> tuple[Dwells, dict[str, Array]]:
    columns = log.columns()
    gaps = np.diff(columns["time"]) > 1.5 / log.rate
    wrench = np.stack([columns[channel] for channel in SPATIAL_CHANNELS], axis=1)
    return Dwells.of(columns, MotionForm.POSE, columns["time"], wrench, gaps), columns


@pytest.mark.parametrize(
    "log",
    [
        {},
        {"gap": 2.0},
        {"transition": 1.0},
        {"transition": 0.4, "rate": 10.0, "dwell": 3.0},
        {"transition": 20.0, "dwell": 30.0, "largest_turn": 0.8},
        {"transition": 20.0, "dwell": 30.0, "largest_turn": 0.6, "pose_noise": 0.002},
        {"pose_noise": 0.01},
        {"pose_noise": 0.003, "transition": 2.0, "rate": 100.0},
        {"dither": 0.008},
        {"dwell": 1.0, "rate": 10.0},
        {"dwells": (2.0, 10.0, 3.0, 5.0, 8.0, 2.0, 4.0, 6.0, 3.0, 9.0, 2.0, 5.0), "transition": 1.5},
        {"drift": 4.0},
        {"flicker": 0.1},
    ],
    ids=str,
)
def test_every_pose_is_a_dwell_and_no_row_of_a_motion_is_in_one(log: dict[str, Any]) -> None:
    dwells, columns = dwells_of(DwellLog(seed=3, **log))
    assert len(dwells) == dwells.distinct == 12
    assert dwells.are_poses
    inside = np.zeros(len(columns["time"]), dtype=bool)
    for begin, end in dwells.ends:
        inside[begin:end] = True
    # A transition begins and ends so slowly that its first and last rows are at the pose.
    moving = (columns["resting"] == 0) & inside
    assert moving.sum() <= 0.2 * max((columns["resting"] == 0).sum(), 1)
    assert inside[columns["resting"] == 1].mean() > 0.6


def test_rows_after_a_stop_are_left_out_until_the_readings_have_settled() -> None:
    settled, columns = dwells_of(DwellLog(seed=1, settling=(3.0, 0.5)))
    plain, _ = dwells_of(DwellLog(seed=1))
    assert (settled.rows < plain.rows).all()
    first = columns["time"][settled.ends[:, 0]] - columns["time"][plain.ends[:, 0]]
    # The mean of what is left of the transient, over 4 s, is less than the std of the mean, 0.01 N.
    assert (3.0 * np.exp(-first / 0.5) * 0.5 / 4 < 0.01).all()
    assert (settled.rows >= 0.5 * plain.rows).all()


@pytest.mark.parametrize("rate", [0.2, 1.0])
def test_a_motion_without_rest_has_no_dwells(rate: float) -> None:
    time = np.arange(3000) / 50
    angle = 0.8 * np.sin(rate * time) + 0.5 * np.sin(2.3 * rate * time + 1)
    dwells = Dwells.of({"phi": angle}, MotionForm.PLANAR_POSE, time, np.zeros((3000, 3)), np.zeros(2999, dtype=bool))
    assert not dwells.are_poses


@pytest.mark.parametrize(("white", "slow"), [(0.1, 0.0), (0.1, 0.03), (0.02, 0.05)])
def test_the_covariance_of_means_is_that_of_the_noise(white: float, slow: float) -> None:
    """Over 200 series, the chi-square of 12 means about their mean, in the covariance estimated, is its freedom."""
    rng = np.random.default_rng(4)
    middles, chi_square = np.stack([3.0 + 6.0 * np.arange(12), np.full(12, 6.0)]), []
    for _ in range(200):
        series = white * rng.standard_normal(1800) + (flicker(rng, 1800, slow) if slow else 0.0)
        pieces = np.split(series[:, None], 12)
        noise = MeanNoise.of(pieces, middles)
        inverse = np.linalg.inv(noise.covariance[0] + 1e-12 * np.eye(12))
        means, ones = np.array([piece.mean() for piece in pieces]), np.ones(12)
        means = means - (ones @ inverse @ means) / (ones @ inverse @ ones)
        chi_square.append(float(means @ inverse @ means) / 11)
    # F is not negative, so that white noise is taken for a little larger than it is.
    assert 0.6 < np.median(chi_square) < 1.2


def test_a_steady_drift_is_no_noise() -> None:
    rng = np.random.default_rng(5)
    series, times = 0.1 * rng.standard_normal(1800), np.stack([3.0 + 6.0 * np.arange(12), np.full(12, 6.0)])
    noises = [MeanNoise.of(np.split((series + drift)[:, None], 12), times) for drift in (0.0, np.linspace(0, 50, 1800))]
    assert noises[1].covariance == pytest.approx(noises[0].covariance, rel=1e-6)
