"""The noise of the motion enters the residual and the columns of a score test: no effect is found for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.robot_motions import raster
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.score_test import DRAWS, DrawnMotion, run_searches, screen
from estimation.fit import Fit, fit
from modeling.chain.model import spatial
from modeling.effects import named
from modeling.rig import Rig
from modeling.significance import LEVELS
from tests.shared.recordings import recording_of
from truewrench.simulated_rig import AutoregressiveNoise, HiddenEffect, SpatialRig, ViscousDrag, simulate


@cache
def fitted(seed: int, *hidden: HiddenEffect) -> Fit:
    """A rigid tool fitted to a single run, its pose logged in micrometres, in noise that a high rate shows through."""
    rig = SpatialRig()
    noise = AutoregressiveNoise(rho=0.95)
    frame = simulate(
        rig, raster(seed), hidden=hidden, repeats=1, samples_per_period=1500, noise=noise, seed=seed
    )  # fmt: skip
    return fit(spatial(), recording_of(frame, without=("repeat",), name="run", rig=Rig.from_data({})))


def test_what_depends_on_an_auxiliary_signal_is_judged_at_drawn_motions() -> None:
    """A drag sought in a model with the temperature, and the temperature's effect sought beside a rigid tool.

    The drag is significant in its own score test (p < 1e-6 in this seed), so that motions are drawn. Each draw has the
    recording's temperature, smoothed as that is.
    """
    thermal, rigid = named("thermal_drift"), fitted(0, ViscousDrag(c=0.15))
    recording = rigid.recordings[0]
    (test,) = screen(fit(rigid.model + thermal, recording), [named("viscous_drag")])
    assert test.p_value < 1e-6
    drawn = DrawnMotion.of(rigid)
    assert drawn is not None
    for drawn_recording in (draw.recordings[0] for draw in drawn.fits):
        assert drawn_recording.auxiliary == recording.auxiliary == ("temperature",)
        drawn_temperature = drawn_recording.motion.model_signals["temperature"]
        np.testing.assert_array_equal(drawn_temperature, recording.motion.model_signals["temperature"])
    (search,) = run_searches([(drawn.fits[0], thermal.restricted(rigid.model.space))], ScreeningCache())
    assert search.excited  # else an input is missing


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2))])
def test_hysteresis_is_not_found_for_the_noise_of_the_motion(seed: int) -> None:
    """The play's column is the sign of the load's rate, which the noise of the motion turns where the load rests."""
    found, cache = fitted(seed), ScreeningCache()
    (test,) = screen(found, [named("sensor_hysteresis")], cache=cache)
    (search,) = run_searches([(found, named("sensor_hysteresis").restricted(found.model.space))], cache)
    assert test.p_value > LEVELS.effect
    assert seed or search.p_value < LEVELS.effect / 10  # of the first, without the motion's noise


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
    assert drawn.largest_power < NullModel(found).cost


def test_all_fits_to_the_same_recordings_are_judged_at_the_same_motions() -> None:
    """Drawn once; another fit has its own predictions there, those of a fit with motions drawn for it alone."""
    found, cache = fitted(0), ScreeningCache()
    other = replace(found, theta=found.theta * 1.1)
    first, second, alone = DrawnMotion.of(found, cache), DrawnMotion.of(other, cache), DrawnMotion.of(other)
    assert first is not None
    assert second is not None
    assert alone is not None
    for one, two, own in zip(first.fits, second.fits, alone.fits, strict=True):
        assert one.recordings[0].motion is two.recordings[0].motion
        assert np.ptp(one.recordings[0].wrench - two.recordings[0].wrench) > 0
        np.testing.assert_array_equal(two.whitened_residual(), own.whitened_residual())


def test_motions_are_drawn_of_recordings_that_nothing_was_derived_from_yet() -> None:
    found = fitted(0)
    fresh = replace(found, problem=found.problem.of_recordings([r.moved(derivatives={}) for r in found.recordings]))
    drawn, again = DrawnMotion.of(found), DrawnMotion.of(fresh)
    assert drawn is not None
    assert again is not None
    assert again.largest_power == pytest.approx(drawn.largest_power, rel=1e-9) != 0.0
