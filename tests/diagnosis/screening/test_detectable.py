"""What is stated as detectable: of a place that the noise has no say in, and found there as often as is said."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from diagnosis.screening.score_test import ScoreTest, screen
from estimation.fit import fit
from estimation.multiplicity import bonferroni_level
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import Silence
from tests.shared.rigs import RIG
from truewrench.simulated_rig import PlanarRig, ViscousDrag, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]

REPEATS, SAMPLES, CANDIDATES = 4, 250, 24
TAIL = 1e-3
"""Probability of the calibration to fail although the power is as stated."""


@cache
def readings(drag: float) -> dict[str, Array]:
    """Columns without noise, with a drag at the sensor's origin."""
    rig = PlanarRig()
    frame = simulate(
        rig,
        rig.random_motion(seed=3),
        hidden=(ViscousDrag(c=drag, d=0.0),) if drag else (),
        repeats=REPEATS,
        samples_per_period=SAMPLES,
        noise=Silence(),
        seed=3,
    )
    return {str(name): frame[name].to_numpy(dtype=float) for name in frame}


def screened(effect: str, seed: int, drag: float = 0.0) -> ScoreTest:
    """The score test of an effect in white noise of that seed."""
    rng, columns = np.random.default_rng(seed), dict(readings(drag))
    for channel, std in zip(("fx", "fy", "tau"), PlanarRig().noise, strict=True):
        columns[channel] = columns[channel] + std * rng.standard_normal(REPEATS * SAMPLES)
    recording = from_columns(columns, rig=RIG)
    (test,) = screen(fit(planar(RIG), recording), [named(effect)], candidates=CANDIDATES)
    return test


@pytest.mark.parametrize("effect", ["viscous_drag", "translational_friction"])
def test_it_is_stated_for_a_place_that_the_noise_has_no_say_in(effect: str) -> None:
    tests = [screened(effect, seed) for seed in (1, 2)]
    assert [test.detectable_at for test in tests] == [{f"{effect}.d": 0.0}] * 2  # no lever: the hardest of five places


@pytest.mark.long(seconds=20)
def test_it_is_found_there_as_often_as_is_said() -> None:
    """60 recordings with the drag that 20 others state on average; the power may be up to five points off."""
    drag = float(np.mean([screened("viscous_drag", seed).detectable["viscous_drag.c"] for seed in range(100, 120)]))
    found = sum(screened("viscous_drag", seed, drag).p_value < bonferroni_level(CANDIDATES) for seed in range(60))
    assert binom.ppf(TAIL, 60, 0.75) <= found <= binom.isf(TAIL, 60, 0.85)
