"""Recordings of a six-axis sensor with a known matrix: of its tool, and with two added masses; MuJoCo simulates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

import truewrench as tw
from estimation.fit import Fit
from estimation.recordings.recording import Recording
from modeling.rigid_body import Load
from modeling.space import Space
from tests.shared.recordings import base, recording_of
from tests.shared.rigs import SIMULATED, carrying
from truewrench import simulated_rig as hidden
from truewrench.simulated_rig.rigs import SpatialRig

Array = NDArray[np.float64]

CHANNELS = Space.SPACE.channels
TWO, SIDE = Load(mass=2.0, at=(0.0, 0.0, 0.05)), Load(mass=1.0, at=(0.06, -0.03, 0.02))
LOADS = {"two": TWO, "side": SIDE}
MATRIX = ("gain", "sensor_crosstalk")
SIZE = np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05])
"""Of the torques over the forces, m: crosstalk is a share of a channel's usual load."""


def loaded(load: Load | None) -> SpatialRig:
    rig = SIMULATED[Space.SPACE]
    assert isinstance(rig, SpatialRig)
    return rig if load is None or load.mass is None else carrying(rig, load.mass, load.at)


@cache
def wrenches(name: str, motion: int, effects: tuple[hidden.HiddenEffect, ...] = ()) -> Recording:
    """Noise-free, with the rig's biases; of the empty rig or with one of the loads."""
    rig = replace(loaded(LOADS.get(name)), noise=(1e-9,) * 6)
    frame = hidden.simulate(
        rig,
        rig.random_motion(seed=motion),
        hidden=list(effects),
        repeats=3,
        samples_per_period=150,
        seed=1,
    )
    return recording_of(frame, without=("temperature",))


def recorded(matrix: Array, seed: int, effects: tuple[hidden.HiddenEffect, ...] = ()) -> dict[str, Recording]:
    """Three recordings by a sensor with this matrix from true wrench to reading, each with noise of its own."""
    rng = np.random.default_rng(seed)
    several = {}
    for motion, name in enumerate(("empty", *LOADS), 1):
        clean = wrenches(name, motion, effects)
        noise = rng.normal(0.0, SIMULATED[Space.SPACE].noise, clean.wrench.shape)
        several[name] = clean.with_readings(clean.wrench @ matrix.T + noise)
    return several


def wrong_matrix(seed: int) -> tuple[Array, dict[str, float]]:
    """A sensor with gains wrong by up to 5 % and crosstalk of up to 2 %, and its parameters."""
    rng = np.random.default_rng(seed)
    gains = 1 + rng.uniform(-0.05, 0.05, 6)
    leaks = rng.uniform(-0.02, 0.02, (6, 6)) * SIZE[:, None] / SIZE
    np.fill_diagonal(leaks, 0.0)
    truth = {f"gain.{channel}": float(gain) for channel, gain in zip(CHANNELS, gains, strict=True)}
    for i, j in permutations(range(6), 2):
        truth[f"sensor_crosstalk.{CHANNELS[i]}_{CHANNELS[j]}"] = float(leaks[i, j])
    return (np.eye(6) + leaks) @ np.diag(gains), truth


def of_matrix() -> tw.WrenchModel:
    model = base(Space.SPACE)
    for effect in MATRIX:
        model = model + effect
    return model


def weighed(seed: int) -> tuple[Fit, dict[str, float]]:
    matrix, truth = wrong_matrix(seed)
    fitted = tw.fit(of_matrix(), recorded(matrix, seed), loads=LOADS)
    rig = SIMULATED[Space.SPACE]
    return fitted, truth | {"m": rig.mass}
