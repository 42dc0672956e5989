"""The recordings that ruin a diagnosis of a single run: slow, held, drifting, noisy, incomplete, and not the tool's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from benchmarks.robot_motions import NearlyRepeated, QuinticPath, point_to_point
from benchmarks.single_run import POSITION, RIG, UNSTATED, SingleRun, held_pose, noisy_pose, recorded, truth_of
from benchmarks.unlisted_physics import GuidingHand
from estimation.recordings.recording import Recording
from modeling.rig import Rig
from truewrench.simulated_rig import (
    BiasDrift,
    CableSpring,
    GravityTilt,
    HiddenEffect,
    SensorLag,
    ViscousDrag,
    simulate,
)

REPEATS, PERIOD, SAMPLES = 8, 5.0, 500
"""Of what repeats nearly."""
Log = Callable[[int], pd.DataFrame]


@dataclass(frozen=True)
class Row:
    """A kind of recording: its log by seed, what is hidden, and what the diagnosis should say."""

    title: str
    log: Log
    hidden: tuple[HiddenEffect, ...] = ()
    should: str = "nothing_missing"
    repeats: bool = False
    rig: Rig = UNSTATED
    tool: bool = True

    def recording(self, seed: int) -> Recording:
        """As it is read."""
        return recorded(self.log(seed), self.rig, repeats=self.repeats)

    @property
    def truth(self) -> dict[str, float]:
        """Of all parameters that do not depend on a place; none where the wrench is not the tool's."""
        if not self.tool:
            return {}
        placed = [effect for effect in self.hidden if not isinstance(effect, CableSpring)]
        return truth_of(placed)


def run(seed: int, *hidden: HiddenEffect) -> SingleRun:
    """Sines in white noise, or, of even seeds, a raster in 1/f noise."""
    noise, motion = ("white", "sines") if seed % 2 else ("1/f", "raster")
    return SingleRun(noise=noise, motion=motion, seed=seed, hidden=hidden)


def slow(seed: int) -> pd.DataFrame:
    """30 s of sines up to 0.5 Hz at 10 Hz."""
    motion = RIG.random_motion(seed=seed, period=30.0, harmonics=15)
    return simulate(RIG, motion, repeats=1, samples_per_period=300, noise=run(seed).noise_model, seed=seed)


def held(seed: int, rate: float) -> pd.DataFrame:
    """A pose with new values at `rate` (Hz)."""
    return held_pose(run(seed).frame(), rate)


def nearly_repeated(seed: int, size: float) -> pd.DataFrame:
    """Eight repeats of 5 s whose motion differs by `size`, rad and m."""
    motion = NearlyRepeated(RIG, size, seed, PERIOD, REPEATS)
    frame = simulate(RIG, motion, repeats=1, samples_per_period=REPEATS * SAMPLES, seed=seed)
    return frame.assign(repeat=np.arange(len(frame)) // SAMPLES)


def upright(seed: int) -> pd.DataFrame:
    """Point to point without a turn."""
    path = point_to_point(seed)
    path = QuinticPath(path.period, path.poses * [1, 1, 1, 0, 0, 0], path.start, path.move)
    return simulate(RIG, path, repeats=1, samples_per_period=1500, noise=run(seed).noise_model, seed=seed)


def compensated(seed: int) -> pd.DataFrame:
    """Nothing but noise in the wrench."""
    frame = run(seed).frame()
    series = run(seed).noise_model.draw(np.random.default_rng([seed, 9]), len(frame), len(RIG.channels))
    return frame.assign(**dict(zip(RIG.channels, (series * RIG.noise).T, strict=True)))


def of_effects(title: str, *hidden: HiddenEffect, should: str = "") -> Row:
    """Runs with something hidden."""
    return Row(title, lambda seed: run(seed, *hidden).frame(), hidden, should or "explained, both")


DRAG, LAG, TILT, TETHER, DRIFT = ViscousDrag(), SensorLag(), GravityTilt(), CableSpring(), BiasDrift()
SIGN_STATED = Rig.from_data({"sensor": {"convention": "on_tool"}})
ENCODER = (1e-3, 1e-4)
"""Noise of a pose, rad and m."""


def rows() -> Iterator[Row]:
    """All kinds, in the order of the issue."""
    yield Row("10 Hz log", slow)
    for rate in (25.0, 50.0):
        yield Row(f"pose held, {rate:.0f} Hz", partial(held, rate=rate))
    yield of_effects("drift", DRIFT, should="slow change, or bias_drift")
    for size in (1e-3, 3e-3):
        yield Row(f"repeats differ by {size:g}", partial(nearly_repeated, size=size), repeats=True)
    yield Row("encoder noise", lambda seed: noisy_pose(run(seed).frame(), *ENCODER, seed))
    yield replace(
        of_effects("encoder noise, drag", DRAG, should="drag"),
        log=lambda seed: noisy_pose(run(seed, DRAG).frame(), *ENCODER, seed),
    )
    yield Row("no position", lambda seed: run(seed).frame().drop(columns=list(POSITION)), should="unexplained: log it")
    yield of_effects("drag, lag", DRAG, LAG)
    yield of_effects("tilt, tether", TILT, TETHER)
    yield of_effects("drag, drift", DRAG, DRIFT, should="drag, partly_explained")
    for row in (
        of_effects("hand most of the time", GuidingHand(), should="unexplained, no mass"),
        Row("compensated", compensated, should="no tool", tool=False),
        Row("no turn", upright, should="weight not known"),
    ):
        yield row
        yield replace(row, title=f"{row.title}, sign stated", rig=SIGN_STATED)
