"""Steadiness of a single run's residual: noise of any colour is steady; knocks and a gear's ripple are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, kurtosistest, t

from diagnosis.comparison.slow_residual import SlowResidual
from diagnosis.comparison.steadiness import (
    kurtosis_p_value,
    squares_p_value,
    steadiness_p_values,
    unsteady_variance,
)
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.significance import LEVELS
from tests.test_slow_residual import NOISES, SEEDS, TAIL

Array = NDArray[np.float64]
Residual = Callable[[np.random.Generator, int], Array]

UNITS = {"fx": "N", "fy": "N", "tau": "N m"}
LEVEL = 0.05
"""Of the calibration: at 1 % a test that is twice too generous would pass too often."""


def recording(samples: int) -> Recording:
    """A tool that turns, with readings that do not matter."""
    time = np.arange(samples) * 0.01
    columns = {"time": time, "phi": np.sin(time), "px": 0 * time, "py": 0 * time}
    rng = np.random.default_rng(0)
    return from_columns(columns | {c: rng.normal(size=samples) for c in UNITS}, name="run")


def knocks(rng: np.random.Generator, n: int) -> Array:
    """White noise and a knock of fifteen times its std about every half second."""
    return np.asarray(rng.normal(size=n) + 15 * rng.choice([-1, 1], size=n) * (rng.uniform(size=n) < 0.02))


def ripple(rng: np.random.Generator, n: int) -> Array:
    """White noise and a wave three times as large, at thirty periods a turn of an axis that swings within a radian."""
    angle = sum(np.sin(2 * np.pi * np.arange(n) / period + rng.uniform(0, 6)) / 3 for period in (293, 401, 547))
    return np.asarray(rng.normal(size=n) + 3 * np.sqrt(2) * np.sin(30 * angle))


def found(kind: Residual, seed: int, samples: int) -> SlowResidual:
    """In tau, beside noise in fx and fy."""
    rng = np.random.default_rng(seed)
    columns = [rng.normal(size=samples), rng.normal(size=samples), kind(rng, samples)]
    return SlowResidual.of_unsteady(recording(samples), np.stack(columns, axis=1) * [0.2, 0.3, 0.02], UNITS)


@pytest.mark.parametrize("kind", [lambda rng, n: rng.normal(size=n), knocks, lambda rng, n: rng.laplace(size=n)])
@pytest.mark.parametrize("samples", [40, 320, 5000])
def test_kurtosis_is_that_of_scipy(kind: Residual, samples: int) -> None:
    rows = kind(np.random.default_rng(samples), samples)
    assert kurtosis_p_value(rows) == pytest.approx(float(kurtosistest(rows, alternative="greater").pvalue), rel=1e-9)


def test_squares_are_at_their_level() -> None:
    """Independent normal rows: between the bounds that the level leaves, up and down."""
    rng = np.random.default_rng(1)
    alarms = sum(squares_p_value(rng.normal(size=1500)) < LEVEL for _ in range(1000))
    assert binom.ppf(TAIL, 1000, LEVEL / 2) <= alarms <= binom.isf(TAIL, 1000, LEVEL)


def test_sizes_that_follow_each_other_are_found() -> None:
    """Noise whose std swings by a third."""
    rng = np.random.default_rng(2)
    swing = 1 + np.sin(np.arange(3000) / 100) / 3
    assert squares_p_value(swing * rng.normal(size=3000)) < 1e-6


@pytest.mark.parametrize(
    "noise", ["white", *(pytest.param(n, marks=pytest.mark.long) for n in ("autoregressive", "pink"))]
)
def test_p_values_hold_in_noise_of_any_colour(noise: str) -> None:
    """At most the stated share of channels, with a probability of failure of TAIL; tones are left to the next test."""
    samples, channels = 1500, 3 * SEEDS
    rng = np.random.default_rng(3)
    residual = np.stack([NOISES[noise](rng, samples) for _ in range(channels)], axis=1)
    alarms = (steadiness_p_values(recording(samples), residual) < LEVEL).sum()
    assert alarms <= binom.isf(TAIL, channels, LEVEL)


@pytest.mark.parametrize("samples", [400, 1500])
@pytest.mark.parametrize("noise", NOISES)
def test_noise_comes_and_goes_less_than_it_stays(noise: str, samples: int) -> None:
    rng = np.random.default_rng(4)
    unsteady, steady = unsteady_variance(np.stack([NOISES[noise](rng, samples) for _ in range(SEEDS)], axis=1))
    assert (unsteady > steady).sum() <= binom.isf(TAIL, SEEDS, LEVELS.effect)


@pytest.mark.parametrize(("kind", "least"), [(knocks, 19), (ripple, 10)])
def test_what_comes_and_goes_is_found(kind: Residual, least: int) -> None:
    """In its channel alone, and said in words that a user can act on; a ripple that never stops is the harder one."""
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
