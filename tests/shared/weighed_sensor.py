"""A six-axis sensor of a known matrix that weighs its tool alone and with two added masses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from estimation.recordings.recording import Recording
from modeling.space import Space
from tests.shared.recordings import Silence, recording_of
from tests.shared.rigs import SIMULATED
from truewrench.simulated_rig import SimulatedRig, simulate

Array = NDArray[np.float64]

CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
PLACES: Mapping[str, tuple[float, tuple[float, float, float]]] = {
    "two": (2.0, (0.0, 0.0, 0.05)),
    "side": (1.0, (0.06, -0.03, 0.02)),
}
"""The added masses, kg, and their centres, m, by recording."""
LOADS = {name: f"{mass}@{x},{y},{z}" for name, (mass, (x, y, z)) in PLACES.items()}
"""The same as the command line has them."""
SCALE = np.array([1, 1, 1, 0.05, 0.05, 0.05])
"""N or N m of each channel, to which crosstalk is in proportion: a lever of 50 mm."""


def random_matrix(seed: int) -> Array:
    """From true wrench to reading (6, 6): gains within 5 %, crosstalk within 2 %."""
    rng = np.random.default_rng(seed)
    gains = np.diag(1 + rng.uniform(-0.05, 0.05, 6))
    crosstalk = rng.uniform(-0.02, 0.02, (6, 6)) * SCALE[:, None] / SCALE
    np.fill_diagonal(crosstalk, 0.0)
    return np.asarray((np.eye(6) + crosstalk) @ gains)


def weighed(matrix: Array, seed: int, loads: Mapping[str, object] = PLACES, motion: int = 1) -> dict[str, Recording]:
    """Recordings of a sensor of that matrix: `empty`, and with each of the loads, all in motions of their own."""
    return {name: _read(name, matrix, [seed, i], motion + i) for i, name in enumerate(("empty", *loads))}


def _read(name: str, matrix: Array, seed: list[int], motion: int) -> Recording:
    frame, rig = _true_wrench(name, motion).copy(), SIMULATED[Space.SPACE]
    noise = np.random.default_rng(seed).normal(size=(len(frame), 6)) * np.array(rig.noise)
    frame[list(CHANNELS)] = frame[list(CHANNELS)].to_numpy() @ matrix.T + np.array(rig.bias) + noise
    return recording_of(frame, without=("temperature",), name=name)


@cache
def _true_wrench(name: str, motion: int) -> pd.DataFrame:
    """Without noise and bias."""
    rig = SIMULATED[Space.SPACE] if name not in PLACES else _with_mass(SIMULATED[Space.SPACE], *PLACES[name])
    repeated = rig.random_motion(seed=motion)
    frame = simulate(rig, repeated, repeats=3, samples_per_period=100, noise=Silence(), seed=0)
    frame[list(CHANNELS)] = frame[list(CHANNELS)].to_numpy() - np.array(rig.bias)
    return frame


def _with_mass(rig: SimulatedRig, mass: float, place: tuple[float, float, float]) -> SimulatedRig:
    """The rig with a point mass on its tool."""
    r = np.array(place)
    xx, xy, xz, yy, yz, zz = mass * (r @ r * np.eye(3) - np.outer(r, r))[np.triu_indices(3)]
    own = rig.inertia
    return replace(
        rig,
        mass=rig.mass + mass,
        first_moment=tuple(np.array(rig.first_moment) + mass * r),
        inertia=tuple(np.array(own) + np.array([xx, xy, xz, yy, yz, zz])),
    )
