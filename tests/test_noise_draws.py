"""White noise of the score tests: the same for every process and number of rows, and white.

Draws are seeded, so that a test fails always or never.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.diagnosis import diagnose
from diagnosis.parallel.workers import Workers, run_spmd
from diagnosis.screening.noise_draws import NOISE_DRAWS, ROWS_AT_ONCE, NoiseDraws
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from modeling.errors import InputError

Array = NDArray[np.float32]
ROWS = 3 * (400 + 2)


def recording(repeats: int) -> Recording:
    time = np.arange(400) * 0.01
    columns = {"time": time, "phi": np.sin(2 * np.pi * time)}
    columns |= {name: np.random.default_rng(1).standard_normal(400) for name in ("fx", "fy", "tau")}
    counted = {"repeat": np.repeat(np.arange(repeats), 400 // repeats)} if repeats > 1 else {}
    return from_columns(columns | counted, rig=None)


@pytest.mark.parametrize("rows", [1, ROWS_AT_ONCE - 1, ROWS_AT_ONCE, 2 * ROWS_AT_ONCE + 17])
def test_the_first_rows_are_the_same_however_many_are_drawn(rows: int) -> None:
    growing, at_once = NoiseDraws(), NoiseDraws().first(3 * ROWS_AT_ONCE)
    np.testing.assert_array_equal(growing.first(rows), at_once[:rows])
    np.testing.assert_array_equal(growing.first(3 * ROWS_AT_ONCE), at_once)
    np.testing.assert_array_equal(growing.first(rows), at_once[:rows])


def test_they_are_white() -> None:
    """Of 100 000 draws mean and variance have the std 0.003 and 0.0045; beyond four of them 1 in 8000."""
    drawn = NoiseDraws().first(1000).astype(np.float64)
    assert abs(drawn.mean()) < 4 * 0.0032
    assert abs(drawn.var() - 1) < 4 * 0.0045
    assert abs(np.mean(drawn[1:] * drawn[:-1])) < 4 * 0.0032


def test_one_process_draws_for_all() -> None:
    """What a forked copy has drawn is what the original sees, without drawing."""
    draws = NoiseDraws.shared_for([recording(4)])

    def by_the_copy(team: Workers) -> Array:
        if team.rank == team.count - 1:
            assert draws.draw() == ROWS
        team.map(abs, [0, 1])  # waits for the copy
        draws.mark_drawn(ROWS)
        return draws.first(ROWS).copy()

    np.testing.assert_array_equal(run_spmd(2, by_the_copy), NoiseDraws().first(ROWS))
    np.testing.assert_array_equal(draws.first(ROWS), NoiseDraws().first(ROWS))
    draws.forget()
    assert draws.first(3).shape == (3, NOISE_DRAWS)


def test_room_is_known_before_a_fit_for_repeats_only() -> None:
    assert NoiseDraws.shared_for([recording(4), recording(1)]).draw() == 0
    assert NoiseDraws.shared_for([recording(4), recording(2)]).draw() == 2 * ROWS


def test_no_recording_is_refused_as_before() -> None:
    with pytest.raises(InputError, match="no recording was given"):
        diagnose(planar(), [])
