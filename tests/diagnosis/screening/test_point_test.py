"""Score tests of all amplitudes together and of the strongest alone: level, power and detectable noncentrality."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from diagnosis.screening.projection import PointTest, Score
from estimation.noise.whitened_spectrum import NoiseLevel

Array = NDArray[np.float64]

WHITE = NoiseLevel()
LEVEL = 0.05
TAIL = 1e-4
"""Probability of a calibration test to fail although the level holds."""


def point_test(scores: Array, noise: NoiseLevel = WHITE) -> PointTest:
    """Of amplitudes with orthogonal columns and these estimates over their std."""
    count = len(scores)
    together = Score(float(scores @ scores), count, noise)
    alone = Score(float((scores**2).max()), 1, WHITE, count) if count > 1 else None
    return PointTest(together, alone, scores, np.ones(count), np.ones(count), np.zeros(count))


@pytest.mark.parametrize("amplitudes", [1, 2, 30])
def test_level_holds(amplitudes: int) -> None:
    rng, draws = np.random.default_rng(amplitudes), 2000
    alarms = sum(point_test(rng.standard_normal(amplitudes)).p_value() < LEVEL for _ in range(draws))
    assert alarms <= binom.isf(TAIL, draws, LEVEL)
    assert alarms >= LEVEL * draws / 4  # two tests of one score cost less than a factor of two each


def test_one_real_amplitude_of_many_is_found_where_the_noise_of_all_is_hardly_known() -> None:
    """Thirty amplitudes, one of 10 std; the level of the noise known to a factor e where all thirty come from."""
    scores = np.zeros(30)
    scores[7] = 10.0
    test = point_test(scores, NoiseLevel(log_variance=1.0))
    assert test.together.p_value() > 0.05
    assert test.p_value() < 1e-20


def test_many_small_amplitudes_are_found_together() -> None:
    test = point_test(np.full(30, 2.0))
    assert test.alone is not None
    assert test.alone.p_value() > 0.5
    assert test.p_value() < 1e-8


def test_detectable_noncentrality_is_detected_with_the_stated_power() -> None:
    """One amplitude of thirty; the test of all adds little, so that the power is 80 % or slightly above."""
    rng, draws = np.random.default_rng(5), 1000
    size = float(np.sqrt(point_test(np.zeros(30)).detectable_noncentrality(0.01)[0]))
    shifted = np.eye(30)[0] * size
    found = sum(point_test(rng.standard_normal(30) + shifted).p_value() < 0.01 for _ in range(draws))
    assert binom.ppf(TAIL, draws, 0.8) <= found <= binom.isf(TAIL, draws, 0.88)


def test_score_of_the_motions_noise_is_taken_off() -> None:
    test = point_test(np.array([6.0, 0.5]))
    assert test.p_value() < 1e-6 < 0.1 < test.p_value(from_motion=25.0)
    assert test.p_value(from_motion=100.0) == 1.0


def test_nothing_identifiable_is_not_significant() -> None:
    nothing = PointTest(Score(0.0, 0, WHITE), None, np.zeros(1), np.ones(1), np.ones(1), np.zeros(1))
    assert nothing.p_value() == 1.0
