"""Recordings that pages work with: of the simulated planar arm, written to the current folder as a user has them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truewrench.files.demonstration import HARMONICS, rig_text
from truewrench.simulated_rig import (
    HIDDEN_EFFECTS,
    HiddenEffect,
    PlanarRig,
    resolve_effects,
    simulate,
    static_poses,
    write_recording,
)

RIG = PlanarRig()


def write_rig(path: str = "rig.toml") -> None:
    """The rig file of the simulated arm."""
    Path(path).write_text(rig_text(RIG), encoding="utf-8")


def write_run(
    path: str,
    *hidden: str | HiddenEffect,
    seed: int,
    repeats: int = 8,
    period: float = 5.0,
    samples: int = 500,
    harmonics: int = HARMONICS,
) -> None:
    """One recording of a random motion with these effects hidden, by their ids or themselves."""
    motion = RIG.random_motion(seed=seed, period=period, harmonics=harmonics)
    frame = simulate(RIG, motion, hidden=resolved(hidden), repeats=repeats, samples_per_period=samples, seed=seed)
    write_recording(frame, path)


def resolved(hidden: Sequence[str | HiddenEffect]) -> Sequence[HiddenEffect]:
    """Effects, by their ids or themselves, where the first motion puts them: one rig in all recordings."""
    effects = [HIDDEN_EFFECTS[effect] if isinstance(effect, str) else effect for effect in hidden]
    return resolve_effects(RIG, RIG.random_motion(seed=1, harmonics=HARMONICS), effects)


def write_poses(path: str, poses: NDArray[np.float64], *hidden: str | HiddenEffect, seed: int = 0) -> None:
    """Readings in static poses (n, joints), rad."""
    write_recording(static_poses(RIG, poses, hidden=resolved(hidden), seed=seed), path)
