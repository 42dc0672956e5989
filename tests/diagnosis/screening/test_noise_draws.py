"""White noise of the score tests: the same for every number of rows, and white.

Draws are seeded, so that a test fails always or never.
"""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.diagnosis import diagnose
from diagnosis.screening.null_model import ROWS_AT_ONCE, NoiseDraws
from modeling.chain.model import planar
from modeling.errors import InputError


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


def test_no_recording_is_refused_as_before() -> None:
    with pytest.raises(InputError, match="no recording was given"):
        diagnose(planar(), [])
