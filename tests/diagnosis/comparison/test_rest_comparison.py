"""A residual that changes in motion and not at rest is no noise; noise of any colour does not know which."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from diagnosis.comparison.slow_residual import at_rest, rest_p_values
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.rig import Rig
from modeling.significance import LEVELS
from tests.shared.noises import NOISES, SEEDS, TAIL

Array = NDArray[np.float64]

MOVES, MOVE, DWELL = 12, 100, 60
"""Moves of a run at 100 Hz, samples of each and of the rest after it."""


def point_to_point(moves: int = MOVES, dwell: int = DWELL) -> tuple[Recording, Array]:
    """A run along x in smooth moves with rests between, and where it moves (n,)."""
    rng = np.random.default_rng(0)
    s = np.arange(MOVE) / MOVE
    shape = 10 * s**3 - 15 * s**4 + 6 * s**5
    places = rng.uniform(-0.3, 0.3, moves + 1)
    legs = [np.concatenate([a + (b - a) * shape, np.full(dwell, b)]) for a, b in pairwise(places)]
    x = np.concatenate(legs)
    zero = np.zeros(len(x))
    columns = {"time": np.arange(len(x)) / 100, **{c: zero + rng.normal(size=len(x)) for c in CHANNELS}}
    pose = {
        "px": x + 1e-6 * rng.normal(size=len(x)),
        "py": zero,
        "pz": zero,
        "qx": zero,
        "qy": zero,
        "qz": zero,
        "qw": zero + 1,
    }
    recording = from_columns(columns | pose, name="run", rig=Rig.from_data({}))
    return recording, np.tile(np.arange(MOVE + dwell) < MOVE, moves)


CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")


def test_rest_is_found() -> None:
    recording, moving = point_to_point()
    assert (at_rest(recording) != moving).mean() > 0.85  # a move begins and ends slowly


@pytest.mark.parametrize("noise", NOISES)
def test_noise_is_the_same_in_motion(noise: str) -> None:
    rng = np.random.default_rng(1)
    recording, moving = point_to_point()
    residual = np.stack([NOISES[noise](rng, len(moving)) for _ in range(SEEDS)], axis=1)
    alarms = (rest_p_values(recording, residual) < LEVELS.effect).sum()
    assert alarms <= binom.isf(TAIL, SEEDS, 1.5 * LEVELS.effect)  # neighbouring windows of slow noise hang together


def test_what_changes_with_the_pose_is_found() -> None:
    """An error that is constant at each place, in most of 20 draws of the noise: its changes tell."""
    rng = np.random.default_rng(2)
    recording, moving = point_to_point()
    error = 3.0 * np.tanh(4 * recording.columns["px"])[:, None]
    assert (rest_p_values(recording, error + rng.normal(size=(len(moving), 20))) < LEVELS.effect).mean() >= 0.8


@pytest.mark.parametrize(("moves", "dwell"), [(3, DWELL), (MOVES, 0)])
def test_too_little_rest_says_nothing(moves: int, dwell: int) -> None:
    recording, moving = point_to_point(moves, dwell)
    assert (rest_p_values(recording, np.outer(moving, np.ones(3))) == 1.0).all()
