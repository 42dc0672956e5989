"""Noise level: distribution of a sum of uncertain parts, and p-values in it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, f

from estimation.noise.whitened_spectrum import NoiseLevel


def test_known_noise_is_chi_square() -> None:
    assert NoiseLevel().p_value(9.0, 2) == pytest.approx(chi2.sf(9.0, 2))
    assert NoiseLevel(known=3.0).p_value(9.0, 2) == pytest.approx(chi2.sf(3.0, 2))


def test_noise_estimated_with_few_degrees_of_freedom_is_f() -> None:
    """trigamma(10 / 2) is the variance of the log of an estimate of ten degrees of freedom."""
    trigamma = 0.2213229557
    assert NoiseLevel(log_variance=trigamma).p_value(9.0, 2) == pytest.approx(f.sf(4.5, 2, 10), rel=1e-6)


def test_parts_are_independent() -> None:
    """Sum of three parts of many values each, against draws: 0.02 are about four standard deviations."""
    rng = np.random.default_rng(0)
    values = np.geomspace(0.1, 20, 60)
    chance = [rng.dirichlet(np.full(60, 0.3)) for _ in range(3)]
    level = NoiseLevel(0.5, tuple((values, c) for c in chance))
    drawn = 0.5 + np.sum([rng.choice(values, 20_000, p=c) for c in chance], axis=0)
    assert level.mean == pytest.approx(drawn.mean(), rel=0.02)
    assert level.variance_of_log == pytest.approx(drawn.var() / drawn.mean() ** 2, rel=0.1)
    for score in (5.0, 50.0, 300.0):
        expected = chi2.sf(score / drawn, 3).mean()
        assert level.p_value(score, 3) == pytest.approx(expected, abs=0.003, rel=0.2)


def test_binned_values_keep_the_tail() -> None:
    """The rare large power of one part among a hundred thousand sums."""
    values, chance = np.array([1.0, 100.0]), np.array([1 - 1e-6, 1e-6])
    many = (np.linspace(0.9, 1.1, 400), np.full(400, 1 / 400))
    level = NoiseLevel(0.0, ((values, chance), many))
    assert level.p_value(120.0, 1) == pytest.approx(1e-6 * chi2.sf(120.0 / 101.0, 1), rel=0.02)


def test_recordings_add() -> None:
    level = NoiseLevel(0.0).and_known(0.25, 0.01).and_parts(np.array([[0.5, 1.0]]), np.array([[0.5, 0.5]]), 0.02)
    assert level.mean == pytest.approx(1.0)
    assert level.variance_of_log == pytest.approx(0.03 + 0.0625)


@pytest.mark.parametrize("known", [0.0, 1.0])
def test_parts_without_power_change_nothing(known: float) -> None:
    """A direction in one recording has none in the channels of another: six parts of a hundred zeros each."""
    chance = np.full(100, 0.01)
    plain = NoiseLevel(known).and_parts(np.array([np.linspace(0.5, 2.0, 100)]), chance[None], 0.02)
    nothing = NoiseLevel(known).and_parts(np.zeros((6, 100)), np.tile(chance, (6, 1)), 0.0)
    both = nothing.and_parts(np.array([np.linspace(0.5, 2.0, 100)]), chance[None], 0.02)
    assert both.mean == pytest.approx(plain.mean)
    for score in (1.0, 5.0, 20.0):
        assert both.p_value(score, 2) == pytest.approx(plain.p_value(score, 2), rel=0.02)
    assert nothing.p_value(5.0, 2) == pytest.approx(NoiseLevel(known).p_value(5.0, 2), rel=1e-9)
