"""What the sensor does in recordings of several loads and temperatures alike: found as MuJoCo hides it, else not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

import truewrench as tw
from diagnosis.diagnosis import Diagnosis
from estimation.case import WARMER, Case
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from modeling.rigid_body import Load
from modeling.space import Space
from tests.shared.recordings import base, recording_of
from tests.shared.rigs import SIMULATED, carrying
from truewrench import simulated_rig as hidden
from truewrench.commands.effect_choice import candidate_effects
from truewrench.simulated_rig.rigs import SpatialRig

pytest.importorskip("mujoco")
Array = NDArray[np.float64]
CHANNELS = Space.SPACE.channels
LOADS = {"two": Load(mass=2.0, at=(0.0, 0.0, 0.05)), "side": Load(mass=1.0, at=(0.06, -0.03, 0.02))}
DAYS = {"empty": 10.0, "two": 25.0, "side": 40.0}
"""Temperatures, °C, at which each begins."""
WARMING = 3.0
"""K by which a recording ends warmer."""
PER_KELVIN = dict(zip(CHANNELS, (-5e-4, 3e-4, 4e-4, -2e-4, -5e-4, 4e-4), strict=True))
CANDIDATES = (
    *("gain", "thermal_gain", "thermal_drift", "sensor_hysteresis", "sensor_lag", "time_delay", "sensor_crosstalk"),
    *("sensor_rotation", "gravity_tilt", "gain_nonlinearity"),
)


@cache
def clean(name: str, days: bool, effects: tuple[hidden.HiddenEffect, ...], warm_gain: bool) -> Recording:
    """Almost without noise; `days`: each at its own temperature."""
    rig, load = SIMULATED[Space.SPACE], LOADS.get(name)
    assert isinstance(rig, SpatialRig)
    rig = rig if load is None or load.mass is None else carrying(rig, load.mass, load.at)
    start = DAYS[name] if days else 22.0
    warm_up = hidden.WarmUpTemperature(start=start, end=start + WARMING, noise=0.02)
    mean = warm_up.true(np.linspace(0.0, 4.0, 100)).mean()
    scaled = tuple((channel, slope * (mean - 20.0)) for channel, slope in PER_KELVIN.items())
    every = [*effects, *([hidden.SensorGain(errors=scaled)] if warm_gain else [])]
    motion = rig.random_motion(seed=1 + list(DAYS).index(name))
    rig = replace(rig, noise=(1e-9,) * 6, warm_up=warm_up)
    return recording_of(hidden.simulate(rig, motion, hidden=every, repeats=3, samples_per_period=120, seed=1))


def recorded(
    *effects: hidden.HiddenEffect, seed: int, days: bool = False, warm_gain: bool = False, matrix: Array | None = None
) -> dict[str, Recording]:
    """The three recordings with noise."""
    rng, several = np.random.default_rng(seed), {}
    for name in DAYS:
        recording = clean(name, days, effects, warm_gain)
        wrench = recording.wrench if matrix is None else recording.wrench @ matrix.T
        noise = rng.normal(0.0, SIMULATED[Space.SPACE].noise, wrench.shape)
        several[name] = recording.with_readings(wrench + noise)
    return several


def diagnosed(several: dict[str, Recording], effects: Sequence[str] = CANDIDATES) -> Diagnosis:
    return tw.diagnose(base(Space.SPACE), several, loads=LOADS, effects=effects)


def misses(fit: Fit, truth: dict[str, float]) -> float:
    """Of all the truth, the largest error in std."""
    return max(abs(fit.values[name] - value) / fit.parameters[name].std for name, value in truth.items())


PLAY = hidden.SensorHysteresis(force=0.3, torque=0.012)
WIDTHS = {f"sensor_hysteresis.{channel}": 0.3 if channel.startswith("f") else 0.012 for channel in CHANNELS}
SLOPES = {f"thermal_drift.{channel}": 0.2 if channel.startswith("f") else 0.01 for channel in CHANNELS}


@pytest.mark.long(8)
@pytest.mark.parametrize(
    ("effects", "found", "truth"),
    [
        ((PLAY,), "sensor_hysteresis", WIDTHS),
        ((hidden.SensorLag(time_constant=0.01),), "sensor_lag", {"sensor_lag.time_constant": 0.01}),
        # The zero is each recording's own: what it does as they warm is the same in all.
        ((hidden.ThermalDrift(force=0.2, torque=0.01),), "thermal_drift", SLOPES),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_the_sensor_does_in_every_recording_is_one_effect(
    effects: tuple[hidden.HiddenEffect, ...], found: str, truth: dict[str, float]
) -> None:
    diagnosis = diagnosed(recorded(*effects, seed=3, days=True))
    assert diagnosis.added == (found,)
    assert diagnosis.verdict.value == "explained"
    assert misses(diagnosis.fit, truth) < 4.5  # of six: p < 1e-4


def test_a_gain_that_follows_the_temperature_comes_apart_over_days_and_loads() -> None:
    """MuJoCo scales the readings of each day by the gain of its mean temperature."""
    several = recorded(seed=2, days=True, warm_gain=True)
    diagnosis = diagnosed(several, ("gain", "thermal_gain", "sensor_crosstalk", "thermal_drift"))
    assert diagnosis.added == ("thermal_gain",)
    assert misses(diagnosis.fit, {f"thermal_gain.{channel}": slope for channel, slope in PER_KELVIN.items()}) < 4.5
    both = tw.fit(base(Space.SPACE) + "gain" + "thermal_gain", several, loads=LOADS)
    assert not both.unidentifiable
    assert misses(both, {f"gain.{channel}": 1.0 for channel in CHANNELS}) < 4.5


def test_a_contact_is_compensated_with_the_gain_of_its_temperature() -> None:
    """30 N for a third of a warm recording, in which the sensor reads 0.9 % too much."""
    fit = tw.fit(base(Space.SPACE) + "thermal_gain", recorded(seed=2, days=True, warm_gain=True), loads=LOADS)
    warm = recorded(seed=8, days=True, warm_gain=True)["side"].carrying(LOADS["side"])
    pushed, rows = warm.wrench.copy(), slice(120, 240)
    pushed[rows, 2] -= 30.0 * (1 + PER_KELVIN["fz"] * (warm.columns["temperature"].mean() - 20.0))
    contact = tw.compensate(fit, warm.with_readings(pushed), keep_zero=False)
    force = contact.wrench[rows, 2]
    assert force.mean() == pytest.approx(30.0, abs=0.06)  # noise 0.01, of the slope 0.02
    assert force.mean() - 30.0 < 4 * float(np.sqrt(contact.covariance[rows, 2, 2].mean()))


def test_a_gain_that_is_the_same_on_all_days_is_no_thermal_one() -> None:
    several = recorded(seed=6, days=True, matrix=1.03 * np.eye(6))
    assert diagnosed(several, ("gain", "thermal_gain", "sensor_crosstalk", "thermal_drift")).added == ("gain",)


@pytest.mark.parametrize("name", [*LOADS])
def test_a_load_that_nobody_stated_is_no_gain_of_a_warm_sensor(name: str) -> None:
    several = {each: recording for each, recording in recorded(seed=5, days=True).items() if each in ("empty", name)}
    found = tw.diagnose(base(Space.SPACE), several, effects=["thermal_gain", "thermal_drift", "sensor_lag"])
    assert found.added == ()
    assert found.verdict.value == "unexplained"


def test_what_is_told_is_a_candidate() -> None:
    """On one day no thermal gain, without known loads no gain; both can be given."""

    def candidates(several: dict[str, Recording], loads: bool) -> set[str]:
        carrying = [r.carrying(LOADS[name]) if loads and name in LOADS else r for name, r in several.items()]
        case = Case(base(Space.SPACE), tuple(carrying))
        return {effect.id for effect in candidate_effects(case, [], [])}

    days, day = recorded(seed=1, days=True), recorded(seed=1)
    new = {"gain", "thermal_gain"}
    assert candidates(days, loads=True) & new == new
    assert candidates(days, loads=False) & new == {"thermal_gain"}
    assert candidates(day, loads=True) & new == {"gain"}
    assert candidates(day, loads=False) & new == set()
    lukewarm = {
        name: r.moved(columns={**r.columns, "temperature": r.columns["temperature"] / WARMER})
        for name, r in days.items()
    }
    assert "thermal_gain" in candidates(lukewarm, loads=False)  # 6 K
    alone = {name: r for name, r in days.items() if name == "empty"}
    assert "thermal_gain" not in candidates(alone, loads=False)
    unlogged = {n: r.moved(columns={k: v for k, v in r.columns.items() if k != "temperature"}) for n, r in days.items()}
    assert "thermal_gain" not in candidates(unlogged, loads=False)


@pytest.mark.long(18)
def test_nothing_is_found_in_twenty_sets_where_nothing_is_hidden() -> None:
    """At a level of 1 % together: more than three of 20 with probability below 1e-4."""
    several = [diagnosed(recorded(seed=100 + seed, days=True)).added for seed in range(20)]
    assert sum(map(bool, several)) <= binom.isf(1e-4, 20, 0.01), several
