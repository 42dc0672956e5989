"""Steadiness of a single run's residual: noise of any colour is steady; knocks and a gear's ripple are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfilt
from scipy.stats import binom, kurtosistest, t

from diagnosis.comparison.slow_residual import SlowResidual
from diagnosis.comparison.steadiness import (
    kurtosis_p_value,
    level_spacing,
    octaves_p_value,
    squares_p_value,
    steadiness_p_values,
    unsteady_variance,
)
from modeling.significance import LEVELS
from tests.shared.noises import NOISES, SEEDS, TAIL, Noise

Array = NDArray[np.float64]

UNITS = {"fx": "N", "fy": "N", "tau": "N m"}
LEVEL = 0.05
"""Of the calibration: at 1 % a test that is twice too generous would pass too often."""


def resonance(damping: float, frequency: float = 0.1) -> Noise:
    """Noise of an oscillator of that damping ratio, at a frequency in units of the sampling rate."""
    turn, radius = 2 * np.pi * frequency, np.exp(-2 * np.pi * frequency * damping)
    poles = [1, -2 * radius * np.cos(turn * np.sqrt(1 - damping**2)), radius**2]
    return lambda rng, n: np.asarray(lfilter([1], poles, rng.normal(size=n + 4000))[4000:])


def low_pass(cutoff: float, of: Noise = NOISES["white"]) -> Noise:
    """Behind a Butterworth filter of fourth order, its cutoff in units of the sampling rate."""
    sections = butter(4, 2 * cutoff, output="sos")
    return lambda rng, n: np.asarray(sosfilt(sections, of(rng, n + 2000))[2000:])


def rounded(rng: np.random.Generator, n: int) -> Array:
    """Low-pass noise in steps of three tenths of its std, of which the error follows the slow signal."""
    smooth = LOW_PASS["low-pass at 0.05"](rng, n)
    step = 0.3 * smooth.std()
    return np.asarray(np.round(smooth / step) * step)


LOW_PASS = {"low-pass at 0.05": low_pass(0.05), "low-pass at 0.2": low_pass(0.2)}
RESONANCES = {f"resonance, damping {damping}": resonance(damping) for damping in (0.01, 0.003)}
COLOURS: dict[str, Noise] = NOISES | LOW_PASS | RESONANCES | {"rounded": rounded}
DAILY = ("white", "low-pass at 0.05")
"""Of the colours: the others are in the long tier."""
colours = pytest.mark.parametrize(
    "noise", [pytest.param(c, marks=[] if c in DAILY else pytest.mark.long) for c in COLOURS]
)


def knocks(rng: np.random.Generator, n: int) -> Array:
    """White noise and a knock of fifteen times its std about every half second."""
    return np.asarray(rng.normal(size=n) + 15 * rng.choice([-1, 1], size=n) * (rng.uniform(size=n) < 0.02))


def ripple(rng: np.random.Generator, n: int) -> Array:
    """White noise and a wave three times as large, at thirty periods a turn of an axis that swings within a radian."""
    angle = sum(np.sin(2 * np.pi * np.arange(n) / period + rng.uniform(0, 6)) / 3 for period in (293, 401, 547))
    return np.asarray(rng.normal(size=n) + 3 * np.sqrt(2) * np.sin(30 * angle))


def bursts(rng: np.random.Generator, n: int) -> Array:
    """White noise and, in half of the time, three times as much of it behind a filter at 0.05 of the sampling rate."""
    narrow = LOW_PASS["low-pass at 0.05"](rng, n)
    return np.asarray(rng.normal(size=n) + 3 * narrow / narrow.std() * switched(rng, n))


def vibration(rng: np.random.Generator, n: int) -> Array:
    """White noise and, in half of the time, a sine of five times its std."""
    return np.asarray(rng.normal(size=n) + 5 * np.sin(0.775 * np.arange(n)) * switched(rng, n))


def switched(rng: np.random.Generator, n: int) -> NDArray[np.bool_]:
    """On and off for five hundred samples each."""
    return np.asarray((np.arange(n) + rng.integers(1000)) % 1000 < 500)


def found(kind: Noise, seed: int, samples: int) -> SlowResidual:
    """In tau, beside noise in fx and fy."""
    rng = np.random.default_rng(seed)
    columns = [rng.normal(size=samples), rng.normal(size=samples), kind(rng, samples)]
    return SlowResidual.of_unsteady("run", np.stack(columns, axis=1) * [0.2, 0.3, 0.02], UNITS)


@pytest.mark.parametrize("kind", [lambda rng, n: rng.normal(size=n), knocks, lambda rng, n: rng.laplace(size=n)])
@pytest.mark.parametrize("samples", [40, 320, 5000])
def test_kurtosis_is_that_of_scipy(kind: Noise, samples: int) -> None:
    rows = kind(np.random.default_rng(samples), samples)
    assert kurtosis_p_value(rows) == pytest.approx(float(kurtosistest(rows, alternative="greater").pvalue), rel=1e-9)


@pytest.mark.parametrize("test", [squares_p_value, octaves_p_value])
def test_of_independent_rows_is_at_its_level(test: Callable[[Array], float]) -> None:
    """Independent normal rows: between the bounds that the level leaves, up and down."""
    rng = np.random.default_rng(1)
    alarms = sum(test(rng.normal(size=1500)) < LEVEL for _ in range(1000))
    assert binom.ppf(TAIL, 1000, LEVEL / 2) <= alarms <= binom.isf(TAIL, 1000, LEVEL)


def test_sizes_that_follow_each_other_are_found() -> None:
    """Noise whose std swings by a third."""
    rng = np.random.default_rng(2)
    swing = 1 + np.sin(np.arange(3000) / 100) / 3
    rows = swing * rng.normal(size=3000)
    assert squares_p_value(rows) < 1e-6
    assert octaves_p_value(rows) < 1e-6


@colours
def test_p_values_hold_in_noise_of_any_colour(noise: str) -> None:
    """At most the stated share of channels, with a probability of failure of TAIL."""
    samples, channels = 3000, SEEDS
    rng = np.random.default_rng(3)
    residual = np.stack([COLOURS[noise](rng, samples) for _ in range(channels)], axis=1)
    p_values = steadiness_p_values(residual)
    for level in (LEVEL, LEVELS.effect):
        assert (p_values < level).sum() <= binom.isf(TAIL, channels, level)


@pytest.mark.parametrize("noise", [0.02, 0.05, 0.1, 0.2, 0.4])
def test_rounding_is_no_finding(noise: float) -> None:
    """Of readings of a weight that turns, in steps of 1; knocks that are larger than the steps are found."""
    rng, time = np.random.default_rng(5), np.arange(3000)
    weight = 12 * np.sin(time[:, None] / [170, 110, 260]) + rng.uniform(0, 1, 3)
    exact = weight + noise * rng.normal(size=weight.shape)
    for knocked in (False, True):
        exact[:, 2] += knocked * 15 * rng.choice([-1, 1], size=3000) * (rng.uniform(size=3000) < 0.02)
        readings = np.round(exact)
        np.testing.assert_array_equal(level_spacing(readings), 1.0)
        found = SlowResidual.of_unsteady("run", readings - weight, UNITS, level_spacing(readings))
        assert found.above_noise == (("tau",) if knocked else ())


@pytest.mark.parametrize("samples", [400, 1500])
@pytest.mark.parametrize("noise", COLOURS)
def test_noise_is_no_finding(noise: str, samples: int) -> None:
    """By size and p-value together, channel by channel."""
    rng = np.random.default_rng(4)
    residual = np.stack([COLOURS[noise](rng, samples) for _ in range(SEEDS)], axis=1)
    alarms = [SlowResidual.of_unsteady("run", column[:, None], {"fx": "N"}).above_noise for column in residual.T]
    assert sum(map(bool, alarms)) <= binom.isf(TAIL, SEEDS, LEVELS.effect)


@pytest.mark.parametrize("samples", [400, 1500])
@pytest.mark.parametrize("noise", [*NOISES, "low-pass at 0.2", "rounded"])
def test_noise_comes_and_goes_less_than_it_stays(noise: str, samples: int) -> None:
    rng = np.random.default_rng(4)
    unsteady, steady = unsteady_variance(np.stack([COLOURS[noise](rng, samples) for _ in range(SEEDS)], axis=1))
    assert (unsteady > steady).sum() <= binom.isf(TAIL, SEEDS, LEVELS.effect)


@pytest.mark.parametrize("noise", [*RESONANCES, "low-pass at 0.05"])
def test_narrow_noise_mostly_stays(noise: str) -> None:
    """Of 3000 samples, six decay times of the weaker damping: a fifth of the variance is its own coming and going."""
    rng = np.random.default_rng(4)
    unsteady, steady = unsteady_variance(np.stack([COLOURS[noise](rng, 3000) for _ in range(SEEDS)], axis=1))
    assert float((unsteady / (unsteady + steady)).mean()) < 0.2
    assert (unsteady > steady).mean() < 0.05


@pytest.mark.parametrize(
    ("kind", "least"), [(knocks, 19), (low_pass(0.2, knocks), 19), (ripple, 16), (bursts, 19), (vibration, 16)]
)
def test_what_comes_and_goes_is_found(kind: Noise, least: int) -> None:
    """In its channel alone, and said in words that a user can act on; a wave that never stops is the hardest."""
    all_found = [found(kind, seed, 3000) for seed in range(20)]
    named = [s for s in all_found if s.above_noise == ("tau",)]
    assert len(named) >= least
    assert all("its size comes and goes" in s.sentence for s in named)


def test_bursts_have_their_size() -> None:
    """Half of the time three times the noise: 4.5 beside 1, of which the louder half counts a part as steady."""
    rng = np.random.default_rng(5)
    on = (np.arange(12000) // 1000) % 2 == 1
    residual = rng.normal(size=(12000, 20)) + 3 * on[:, None] * rng.normal(size=(12000, 20))
    unsteady, steady = unsteady_variance(residual)
    assert 1.0 < float(steady.mean()) < 2.0
    assert float((unsteady + steady).mean()) == pytest.approx(float(residual.var()), rel=0.05)


def test_heavy_tails_alone_are_no_misfit() -> None:
    """Noise of Student's t with five degrees of freedom is steady: most of it has no place of its own in the record."""
    heavy = [found(lambda rng, n: np.asarray(t(5).rvs(n, random_state=rng)), seed, 3000) for seed in range(20)]
    assert not any(s.above_noise for s in heavy)
