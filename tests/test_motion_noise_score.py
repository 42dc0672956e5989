"""The noise of the motion enters the residual and the columns of a score test: no effect is found for it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.screening.grid_search import GridSearch
from diagnosis.screening.motion_noise_score import DRAWS, DrawnMotion
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.score_test import run_searches, screen
from diagnosis.screening.screening_cache import ScreeningCache
from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from modeling.chain.model import spatial
from modeling.effects import named
from modeling.rig.rig import Rig
from modeling.significance import LEVELS
from truewrench.simulated_rig import AutoregressiveNoise, HiddenEffect, SpatialRig, ViscousDrag, simulate

Array = NDArray[np.float64]

ROWS, PERIOD, LONG_MOVE, SHORT_MOVE, DWELL = 12, 15.0, 1.0, 0.5, 0.05


class Raster:
    """Rows over a curved surface to and fro, in quintic moves with short dwells; six joint positions (m, rad)."""

    period = PERIOD

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        across = np.repeat(np.linspace(-0.2, 0.2, ROWS), 2)
        along = np.tile([-0.25, 0.25, 0.25, -0.25], ROWS // 2)
        about_tip = 0.5 * np.sin(np.repeat(np.arange(ROWS), 2))
        turned = np.stack([2 * across, -2.4 * along, about_tip], axis=1) + 0.1 * rng.normal(size=(2 * ROWS, 3))
        poses = np.column_stack([along, across, 0.1 * (along**2 + across**2), turned])
        self.poses = np.concatenate([poses, poses[:1]])
        move = np.append(np.resize([LONG_MOVE, SHORT_MOVE], 2 * ROWS - 1), 1.5 * LONG_MOVE)
        scale = PERIOD / (move + DWELL).sum()
        self.start, self.move = np.concatenate([[0.0], np.cumsum(move + DWELL)]) * scale, move * scale

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        time = np.asarray(time) % PERIOD
        i = np.clip(np.searchsorted(self.start, time, side="right") - 1, 0, len(self.poses) - 2)
        lasts, step = self.move[i][:, None], self.poses[i + 1] - self.poses[i]
        s = np.clip((time - self.start[i])[:, None] / lasts, 0, 1)
        return (
            self.poses[i] + step * (10 * s**3 - 15 * s**4 + 6 * s**5),
            step * (30 * s**2 - 60 * s**3 + 30 * s**4) / lasts,
            step * (60 * s - 180 * s**2 + 120 * s**3) / lasts**2,
        )


@cache
def fitted(seed: int, *hidden: HiddenEffect) -> Fit:
    """A rigid tool fitted to a single run, its pose logged in micrometres, in noise that a high rate shows through."""
    rig = SpatialRig()
    noise = AutoregressiveNoise(rho=0.95)
    frame = simulate(
        rig, Raster(seed), hidden=hidden, repeats=1, samples_per_period=1500, noise=noise, seed=seed
    )  # fmt: skip
    columns = {str(c): frame[c].to_numpy() for c in frame if c != "repeat"}
    return fit(spatial(), from_columns(columns, name="run", rig=Rig.from_data({})))


@pytest.mark.parametrize("seed", range(3))
def test_hysteresis_is_not_found_for_the_noise_of_the_motion(seed: int) -> None:
    """The play's column is the sign of the load's rate, which the noise of the motion turns where the load rests."""
    found, cache = fitted(seed), ScreeningCache()
    (test,) = screen(found, [named("sensor_hysteresis")], cache=cache)
    (search,) = run_searches([(found, named("sensor_hysteresis").restricted(found.model.space))], cache)
    assert isinstance(search, GridSearch)
    assert test.p_value > LEVELS.effect
    assert seed or search.p_value() < LEVELS.effect / 10  # of the first, without the motion's noise


def test_drag_is_found_beside_it() -> None:
    (test,) = screen(fitted(0, ViscousDrag(c=0.15)), [named("viscous_drag")])
    assert test.p_value < 1e-6


def test_residual_of_drawn_motions_is_their_noise() -> None:
    """Readings without noise: only what the samples of the motion leave open, as large as the fit counts it."""
    found = fitted(0)
    drawn = DrawnMotion.of(found)
    assert drawn is not None
    assert len(drawn.fits) == DRAWS
    size = np.std([f.residuals[0] for f in drawn.fits], axis=(0, 1))
    counted = np.sqrt(np.mean(found.noise[0].motion.errors ** 2, axis=(0, 1)))  # type: ignore[union-attr]
    assert size == pytest.approx(counted, rel=0.25)
    assert drawn.largest_power < NullModel.of(found, ScreeningCache()).cost
