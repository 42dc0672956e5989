"""Single runs: an estimate that what is missing does not bias more than ordinary least squares, with std that hold."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from estimation.case import Case
from estimation.fit import Fit, fit, unchecked_fit
from modeling.chain.model import spatial
from modeling.rig import Rig
from tests.shared.recordings import recording_of
from truewrench.simulated_rig import (
    AutoregressiveNoise,
    HiddenEffect,
    NoiseModel,
    SensorLag,
    SpatialRig,
    WhiteNoise,
    simulate,
)

Array = NDArray[np.float64]

RIG = SpatialRig()
TRUTH = np.array([*RIG.bias, RIG.mass, *RIG.first_moment, *RIG.inertia])
SEEDS = 3
TAIL = 1e-4
"""Probability of the coverage test to fail although coverage is as assumed there."""


@cache
def fitted(seed: int, noise: NoiseModel, *hidden: HiddenEffect) -> Fit:
    """A rigid tool fitted to one run of 10 s."""
    motion = RIG.random_motion(seed=seed, period=10.0)
    frame = simulate(RIG, motion, hidden=hidden, repeats=1, samples_per_period=1000, noise=noise, seed=seed)
    return fit(spatial(), recording_of(frame, without=("repeat",), name="run", rig=Rig.from_data({})))


def ordinary(found: Fit) -> Array:
    """Parameters (k,) by least squares, each channel weighted by its true noise."""
    weight = np.asarray(RIG.noise)
    rows = found.response().derivative / weight[:, None]
    step = np.linalg.lstsq(rows.reshape(-1, rows.shape[2]), (found.residuals[0] / weight).ravel(), rcond=None)[0]
    return np.asarray(found.theta + step)


@pytest.mark.parametrize("noise", [WhiteNoise(), AutoregressiveNoise(rho=0.95)])
def test_a_hidden_lag_biases_it_no_more_than_least_squares(noise: NoiseModel) -> None:
    """Whitened by the residual's own colour, the mass was off ten times as much."""
    lag = SensorLag(time_constant=0.02)
    errors = np.array([fitted(seed, noise, lag).theta - TRUTH for seed in range(SEEDS)])
    plain = np.array([ordinary(fitted(seed, noise, lag)) - TRUTH for seed in range(SEEDS)])
    ratio = np.sqrt((errors**2).mean(axis=0) / (plain**2).mean(axis=0))
    assert np.exp(np.log(ratio).mean()) < 1.1


@pytest.mark.parametrize("hidden", [(), (SensorLag(time_constant=0.02),)])
def test_std_hold(hidden: tuple[HiddenEffect, ...]) -> None:
    """Coverage of the 95 % intervals of the body in coloured noise; each parameter of a run is a trial."""
    inside = []
    for seed in range(SEEDS):
        found = fitted(seed, AutoregressiveNoise(rho=0.95), *hidden)
        limits = found.intervals()
        inside += ((limits.low <= TRUTH) & (limits.high >= TRUTH))[6:].tolist()
    assert np.sum(inside) >= binom.isf(1 - TAIL, len(inside), 0.9)


def test_the_noise_for_tests_is_the_same() -> None:
    """Only the estimate changes; that of a given noise does not."""
    found = fitted(0, WhiteNoise(), SensorLag(time_constant=0.02))
    again = unchecked_fit(Case(found.model, found.recordings))
    for one, other in zip(found.noise, again.noise, strict=True):
        np.testing.assert_allclose(one.whitener.noise.coefficients, other.whitener.noise.coefficients)  # type: ignore[attr-defined]
    given = fit(found.model, found.recordings, noise=again.noise)
    np.testing.assert_allclose(given.theta, again.theta, rtol=1e-6)
