"""The colour that an autoregression leaves in a single run: scores of slow columns keep their level in any noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import idct
from scipy.stats import binom

from diagnosis.screening.score_test import screen, significant_effects
from estimation.autoregression import fit_autoregression
from estimation.fit import fit
from estimation.noise.whitened_spectrum import NoiseLevel, WhitenedSpectrum, lines
from estimation.noise.whitening import AutoregressiveWhitener
from modeling.chain.model import spatial
from modeling.effects import named
from modeling.rig import Rig
from tests.shared.recordings import recording_of
from truewrench.simulated_rig import (
    AutoregressiveNoise,
    NoiseModel,
    PinkNoise,
    SensorCrosstalk,
    SpatialRig,
    WhiteNoise,
    simulate,
)

Array = NDArray[np.float64]

NOISES: dict[str, NoiseModel] = {
    "white": WhiteNoise(),
    "autoregressive": AutoregressiveNoise(rho=0.95),
    "mild 1/f": PinkNoise(corner=0.1, tones=()),
    "mild 1/f, with tones": PinkNoise(corner=0.1),
}
SEEDS, SAMPLES = 100, 1000
LEVEL = 0.01
TAIL = 1e-3
"""Probability of a calibration test to fail although the level holds."""


def motion_like(rng: np.random.Generator) -> Array:
    """A column of a slow drag or a weight: ten lines of one channel."""
    t = (np.arange(SAMPLES) + 0.5) / SAMPLES
    slow = sum(rng.normal() * np.cos(np.pi * k * t) for k in range(1, 11))
    return np.outer(slow, [1.0, 0.0, 0.0])


def p_value(seed: int, noise: str, size: float = 0.0) -> float:
    """Score test of such a column in noise of three channels, whitened by the autoregression of the residual."""
    rng = np.random.default_rng(seed)
    column = motion_like(rng)
    residual = NOISES[noise].draw(rng, SAMPLES, 3)
    residual += size * column / column.std()
    whitener = AutoregressiveWhitener(SAMPLES, fit_autoregression(residual, np.ones(SAMPLES, dtype=bool)))
    row, tested = whitener.series(residual), whitener.series(column)[:, None]
    tested /= np.linalg.norm(tested)
    score = float((tested[:, 0] @ row) ** 2)
    rest = row - tested[:, 0] * (tested[:, 0] @ row)
    spectrum = WhitenedSpectrum.of(rest, lines(tested, 3)[..., 0] ** 2)
    parts = zip(spectrum.power_along(tested)[:, :, 0].T, spectrum.probability.T, strict=True)
    return NoiseLevel(0.0, tuple(parts)).p_value(score, 1)


@pytest.mark.parametrize("noise", NOISES)
def test_level_holds(noise: str) -> None:
    alarms = sum(p_value(seed, noise) < LEVEL for seed in range(SEEDS))
    assert alarms <= binom.isf(TAIL, SEEDS, LEVEL)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_significant_in_one_over_f_noise(seed: int) -> None:
    """Six axes, one run of 15 s, nothing hidden: with the autoregression alone p of these was 1e-5 to 1e-30."""
    rig = SpatialRig()
    frame = simulate(rig, rig.random_motion(seed=seed, period=15.0), repeats=1, samples_per_period=1500,
                     noise=PinkNoise(tones=()), seed=seed)  # fmt: skip
    fitted = fit(spatial(), recording_of(frame, without=("repeat",), name="run", rig=Rig.from_data({})))
    tests = screen(fitted, [named(i) for i in ("thermal_drift", "sensor_crosstalk", "sensor_gain")])
    assert not significant_effects(tests), [(t.effect.id, t.p_value) for t in tests]


def test_a_leak_is_found_in_noise_that_few_lines_tell() -> None:
    """1 % of fy in fx, one run of 15 s: of all thirty leaks together p is 1e-5 at best, of the strongest 1e-10."""
    rig = SpatialRig()
    frame = simulate(rig, rig.random_motion(seed=0, period=15.0), repeats=1, samples_per_period=1500, seed=0,
                     hidden=[SensorCrosstalk(leaks=(("fy", "fx", 0.01),))], noise=WhiteNoise())  # fmt: skip
    (test,) = screen(
        fit(spatial(), recording_of(frame, without=("repeat",), name="run", rig=Rig.from_data({}))),
        [named("sensor_crosstalk")],
    )
    assert test.p_value < 1e-7


def test_white_noise_hardly_costs_power() -> None:
    """A column of a quarter of the noise, lambda about 60, found as without the spectrum."""
    found = sum(p_value(seed, "white", size=0.25) < LEVEL for seed in range(100))
    assert found >= 95


def test_a_spectrum_is_recovered() -> None:
    """White and 1/f terms of known sizes: the true power at every line within what 1 in 1e5 leaves of the posterior."""
    n, rng = 4000, np.random.default_rng(0)
    line = np.maximum(np.arange(n), 1.0)
    true = 0.8 + 40.0 / line
    rows = np.sqrt(true)[:, None] * rng.standard_normal((n, 2))
    found = WhitenedSpectrum.of(idct(rows, axis=0, norm="ortho").ravel(), np.zeros((n, 2)))
    np.testing.assert_allclose(found.level, np.tile(true[:, None], 2), rtol=0.6)
    np.testing.assert_allclose(found.level[100:], np.tile(true[100:, None], 2), rtol=0.15)
    assert np.all(found.probability.sum(axis=0) == pytest.approx(1.0))
    for line_number in (3, 300):
        column = idct(np.eye(n, 1, -line_number), axis=0, norm="ortho") @ np.array([[1.0, 0.0]])
        power = found.power_along(column.reshape(-1, 1))[:, 0, 0]
        below = float(found.probability[power < true[line_number], 0].sum())
        assert 1e-5 < below < 1 - 1e-5


def test_a_stated_std_is_the_level() -> None:
    """Physics above white noise of the stated std raises nothing; 1/f noise of the stated std keeps its colour."""
    n, rng = 4000, np.random.default_rng(1)
    white = rng.standard_normal((n, 1))
    slow = 3.0 * np.sin(2 * np.pi * 7 * np.arange(n) / n)[:, None]
    above = WhitenedSpectrum.of((white + slow).ravel(), np.zeros((n, 1)), stated=True)
    assert above.level[14] < 2.0 < 0.1 * slow.var() * n  # its own power at that line is thousands
    pink = PinkNoise(corner=1.0, tones=()).draw(rng, n, 1)
    coloured = WhitenedSpectrum.of((pink / pink.std()).ravel(), np.zeros((n, 1)), stated=True)
    assert coloured.level.mean() == pytest.approx(1.0, abs=0.1)
    assert coloured.level[5] > 10
    with_physics = WhitenedSpectrum.of((pink / pink.std() + slow).ravel(), np.zeros((n, 1)), stated=True)
    assert with_physics.level[14] < 4 * coloured.level[14]
    by_chance = WhitenedSpectrum.of((1.1 * pink / pink.std()).ravel(), np.zeros((n, 1)), stated=True)
    np.testing.assert_allclose(by_chance.level[2:], 1.1**2 * coloured.level[2:], rtol=0.05)


def test_power_of_a_record_varies_as_stated() -> None:
    """The variance of the logarithm of a record's power: by the spectrum, and of 400 records, which tell it to 7 %."""
    rng, n = np.random.default_rng(3), 1000
    corner = 500.0
    level = 0.002 * (1 + corner / np.maximum(np.arange(n), 1.0))
    power = (rng.standard_normal((400, n)) ** 2 * level).sum(axis=1)
    rows = idct(np.sqrt(level)[:, None] * rng.standard_normal((n, 1)), axis=0, norm="ortho").ravel()
    found = WhitenedSpectrum.of(rows, np.zeros((n, 1))).log_power_variance[0] + 2 / n
    assert power.var() / power.mean() ** 2 == pytest.approx(found, rel=0.3)


def test_power_along_columns_is_that_of_the_level() -> None:
    n, rng = 300, np.random.default_rng(4)
    found = WhitenedSpectrum.of(np.cumsum(rng.standard_normal((n, 2)), axis=0).ravel() / 10, np.zeros((n, 2)))
    columns = rng.standard_normal((2 * n, 3))
    expected = np.einsum("np,npg->g", found.level, lines(columns, 2) ** 2)
    mean = np.einsum("spg,sp->g", found.power_along(columns), found.probability)
    np.testing.assert_allclose(mean, expected, rtol=1e-10)


def test_lines_of_no_columns() -> None:
    """An effect whose offsets are all known leaves no direction beside them."""
    assert lines(np.zeros((12, 0)), 3).shape == (4, 3, 0)
