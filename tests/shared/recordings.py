"""Recordings of the simulated rig, which several tests analyse."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import named
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from tests.shared.rigs import RIG, SIMULATED
from truewrench.simulated_rig import (
    NOISE_MODELS,
    HiddenEffect,
    NoiseModel,
    PlanarRig,
    SensorCrosstalk,
    ViscousDrag,
    simulate,
)

Array = NDArray[np.float64]

SAMPLES = 250
"""Of a period, where a recording says nothing else."""
DRAG, LEAK = ViscousDrag(c=0.15, d=0.12), SensorCrosstalk(leaks=(("fy", "fx", 0.04),))
CANDIDATES = ("viscous_drag", "sensor_crosstalk", "com_offset")
"""For recordings with the drag and the leak: both, and one that is not there."""
FEW = tuple(named(i) for i in ("viscous_drag", "quadratic_drag", "sensor_lag", "time_delay", "gravity_tilt"))
"""Candidates enough to be wrong with."""


def recording_of(
    frame: pd.DataFrame, *, without: Collection[str] = (), name: str = "recording", rig: Rig | None = None
) -> Recording:
    """The recording in a data frame of the simulated rig, but for some of its columns."""
    columns = {str(column): frame[column].to_numpy() for column in frame if column not in without}
    return from_columns(columns, name=name, rig=rig)


def base(space: Space) -> WrenchModel:
    """The rigid tool, its readings of the sign of the simulated rig's."""
    on_tool = Rig(sensor=SensorDescription(convention=Convention.ON_TOOL))
    return planar() if space is Space.PLANE else spatial(on_tool)


class Silence(NoiseModel):
    """No noise."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        return np.zeros((samples, channels))


@cache
def noiseless_columns(space: Space, hidden: tuple[HiddenEffect, ...], repeats: int, motion: int) -> dict[str, Array]:
    """Columns of a recording without noise."""
    rig = SIMULATED[space]
    frame = simulate(
        rig, rig.random_motion(seed=motion), hidden=hidden, repeats=repeats, samples_per_period=SAMPLES, noise=Silence()
    )
    kept = [str(name) for name in frame if repeats > 1 or name != "repeat"]
    return {name: frame[name].to_numpy(dtype=float) for name in kept}


def recorded(
    space: Space,
    *hidden: HiddenEffect,
    seed: int,
    repeats: int = 4,
    motion: int = 5,
    noise: str = "white",
    zero: Sequence[float] | None = None,
    name: str = "recording",
    temperature: bool = False,
) -> Recording:
    """A recording with noise of the rig's size, the zero moved by `zero`."""
    rig = SIMULATED[space]
    found = dict(noiseless_columns(space, hidden, repeats, motion))
    draws = NOISE_MODELS[noise].draw(np.random.default_rng(seed), len(found["time"]), len(rig.channels))
    for i, channel in enumerate(rig.channels):
        found[channel] = found[channel] + rig.noise[i] * draws[:, i] + (0.0 if zero is None else zero[i])
    if not temperature:
        del found["temperature"]
    links = rig.link_lengths if isinstance(rig, PlanarRig) else None
    return from_columns(found, name=name, rig=Rig(link_lengths=links))


@cache
def drag_and_leak(motion: int) -> Recording:
    """A rig with a drag and a leak between channels."""
    rig = PlanarRig()
    moved = rig.random_motion(seed=motion)
    frame = simulate(rig, moved, hidden=(DRAG, LEAK), repeats=4, samples_per_period=250, seed=motion)
    return recording_of(frame, name=f"motion {motion}", rig=RIG)


def single_run(seed: int, *hidden: HiddenEffect, noise: NoiseModel | str = "white", rig: Rig = RIG) -> Recording:
    """Ten seconds of the planar rig, without repeats."""
    motion = PlanarRig().random_motion(seed=seed)
    frame = simulate(PlanarRig(), motion, hidden=hidden, repeats=1, samples_per_period=1000, noise=noise, seed=seed)
    return recording_of(frame, without=("repeat",), name="run.csv", rig=rig)
