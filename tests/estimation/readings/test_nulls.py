"""Where nothing is mistaken and nothing is hidden, a recording is read as it stands, whatever its noise."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest

from estimation.case import Case
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.errors import InputError
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.recordings import recording_of
from tests.shared.rigs import described
from truewrench.simulated_rig import (
    NoiseModel,
    PinkNoise,
    PlanarRig,
    SimulatedRig,
    SpatialRig,
    WhiteNoise,
    simulate,
    static_poses,
)

NULLS = 50
"""Of each kind of recording."""
SETTINGS = tuple(
    product(
        (SpatialRig(), PlanarRig()),
        (WhiteNoise(), PinkNoise(corner=100.0, tones=())),
        ("on_tool", "on_sensor"),
        (True, False),
    )
)
"""Rig, noise, sign of the readings, and whether that is stated; with such a corner noise is 1/f at all frequencies."""


def recorded(kind: str, rig: SimulatedRig, noise: NoiseModel, seed: int) -> pd.DataFrame:
    """Repeats of a motion, one run of it, the same at 1600 Hz, or poses at rest."""
    if kind == "static":
        return static_poses(rig, 24, noise=noise, seed=seed)
    repeats, samples = {"repeats": (4, 250), "single": (1, 1000), "long": (1, 8000)}[kind]
    motion = rig.random_motion(seed=seed)
    frame = simulate(rig, motion, repeats=repeats, samples_per_period=samples, noise=noise, seed=seed)
    return frame if repeats > 1 else frame.drop(columns="repeat")


def model_of(rig: SimulatedRig, *, stated: bool) -> WrenchModel:
    sensor = SensorDescription(convention=Convention(rig.convention)) if stated else SensorDescription()
    description = replace(described(rig) or Rig(), sensor=sensor)
    return planar(description) if isinstance(rig, PlanarRig) else spatial(description)


@pytest.mark.long(seconds=8)
@pytest.mark.parametrize("kind", ["repeats", "single", "static", "long"])
def test_no_reading_is_invented(kind: str) -> None:
    """Of 200 nulls, 50 of each kind, none is read otherwise than it stands: at most 1.5 % are, at 95 % (3 of 200).

    Nor was one of 900 logs of 12 to 59 poses, nor of 263 of all kinds with white, 1/f and autoregressive noise, tools
    of 0.1 to 6 kg and motions down to a quarter as far: at most 0.22 % of all 1363 are. Of noise with the tails of
    Student's t with 4 degrees of freedom two of 75 had a row named that belongs.
    """
    for seed in range(NULLS):
        nominal, noise, sign, stated = SETTINGS[seed % len(SETTINGS)]
        loudness = np.exp(np.random.default_rng(seed).uniform(-1.6, 1.6))
        rig = replace(nominal, convention=sign, noise=tuple(loudness * std for std in nominal.noise))
        recording = recording_of(recorded(kind, rig, noise, seed), rig=described(rig))
        try:
            case = Case.of(model_of(rig, stated=stated), [recording])
        except InputError as error:
            assert "the sign convention cannot be decided" in error.what  # noqa: PT017  # nothing is invented either
        else:
            assert case.readings == ()
