"""Thermal drift in a single run with a logged temperature: found beside noise that is as slow, and not in it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from diagnosis.screening.score_test import ScoreTest, screen
from estimation.case import Case
from estimation.fit import unchecked_fit
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar
from modeling.effects import named
from modeling.significance import LEVELS
from modeling.space import Space
from tests.shared.recordings import Silence
from tests.shared.rigs import RIG
from truewrench.simulated_rig import NoiseModel, PinkNoise, PlanarRig, ThermalDrift, WhiteNoise, simulate

pytest.importorskip("mujoco")

CANDIDATES = 30
"""More than there are effects in the plane."""


@cache
def clean(slope: float) -> dict[str, np.ndarray]:
    """A minute at 20 Hz without noise, in whose first half the sensor warms up by 3 K; `slope` in N/K."""
    rig = PlanarRig()
    hidden = (ThermalDrift(force=slope, torque=slope / 20),) if slope else ()
    motion = rig.random_motion(seed=1, period=60.0, harmonics=20)
    frame = simulate(rig, motion, hidden=hidden, repeats=1, samples_per_period=1200, noise=Silence())
    return {str(name): frame[name].to_numpy(dtype=float) for name in frame if name != "repeat"}


def drift_test(slope: float, noise: NoiseModel, seed: int) -> ScoreTest:
    """The score test of a drift, of readings in that noise."""
    columns, sizes = dict(clean(slope)), dict(zip(Space.PLANE.channels, PlanarRig().noise, strict=True))
    drawn = noise.draw(np.random.default_rng(seed), len(columns["time"]), len(sizes))
    columns |= {c: columns[c] + size * drawn[:, i] for i, (c, size) in enumerate(sizes.items())}
    recording = from_columns(columns, name="run", rig=RIG)
    return screen(unchecked_fit(Case.of(planar(RIG), (recording,), ())), [named("thermal_drift")])[0]


@pytest.mark.parametrize("noise", [WhiteNoise(), PinkNoise()])
def test_a_drift_that_settles_early_is_found(noise: NoiseModel) -> None:
    """An autoregression of the residual takes it for noise."""
    test = drift_test(0.6, noise, seed=1)
    assert CANDIDATES * test.p_value < LEVELS.effect
    value, std = test.amounts["thermal_drift.fx"]
    assert abs(value - 0.6) < 4 * std


def test_slow_noise_is_no_drift() -> None:
    """1/f noise alone: of four p-values of a valid test one is below the level with a probability of 0.1 %."""
    p_values = [drift_test(0.0, PinkNoise(), seed).p_value for seed in range(4)]
    assert CANDIDATES * min(p_values) > LEVELS.effect


class Wandering(NoiseModel):
    """White noise on a zero that takes a random step at each sample: as slow as any drift, and slower than 1/f."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> np.ndarray:
        return rng.normal(size=(samples, channels)) + np.cumsum(0.05 * rng.normal(size=(samples, channels)), axis=0)


def test_a_zero_that_wanders_is_no_drift() -> None:
    """Of thirty in noise estimated beside the drift three in a hundred were below the level."""
    assert CANDIDATES * min(drift_test(0.0, Wandering(), seed).p_value for seed in range(4)) > LEVELS.effect
