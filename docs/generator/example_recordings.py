"""Recordings that pages work with: of simulated rigs, written to the current folder as a user has them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tests.shared.log_files import CHANNELS, POSITION, ros_messages, ros_types, rotations, write_messages
from tests.shared.rigs import carrying
from truewrench.files.demonstration import HARMONICS, rig_text
from truewrench.simulated_rig import (
    HIDDEN_EFFECTS,
    HiddenEffect,
    PlanarRig,
    SpatialRig,
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


def six_axis_run(*hidden: HiddenEffect, seed: int) -> pd.DataFrame:
    """Four repeats of a motion of 6 s at 125 Hz of the six-axis rig, with these effects hidden."""
    rig = SpatialRig(convention="on_sensor")
    motion = rig.random_motion(seed=seed, period=6.0)
    return simulate(rig, motion, hidden=hidden, repeats=4, samples_per_period=750, seed=seed)


def write_weighed_run(path: str, mass: float = 0.0, at: Sequence[float] = (0.0, 0.0, 0.0), *, seed: int) -> None:
    """A run of the six-axis rig that carries a mass (kg) at a place (m), by a sensor whose gain is 3 % too large."""
    rig = carrying(SpatialRig(convention="on_sensor"), mass, at)
    frame = simulate(rig, rig.random_motion(seed=seed), repeats=3, samples_per_period=200, seed=seed)
    channels = list(rig.channels)
    frame[channels] = 1.03 * (frame[channels] - rig.bias) + rig.bias
    frame.drop(columns="temperature", errors="ignore").to_csv(path, index=False)


def write_ur_log(path: str, *hidden: HiddenEffect, seed: int) -> None:
    """A run as the client of Universal Robots' RTDE records it: rotation vectors, and its sensor's own wrench."""
    frame = six_axis_run(*hidden, seed=seed)
    columns = {"timestamp": 3201.448 + frame["time"]}
    pose = [*(frame[name] for name in POSITION), *rotations(frame).as_rotvec().T]
    columns |= {f"actual_TCP_pose_{i}": column for i, column in enumerate(pose)}
    columns |= {f"ft_raw_wrench_{i}": frame[name] for i, name in enumerate(CHANNELS)}
    pd.DataFrame(columns).to_csv(path, sep=" ", index=False, float_format="%.9g")


def write_ros_bag(path: str, *hidden: HiddenEffect, seed: int) -> None:
    """A run as ROS 2 records it: a wrench as the sensor has it and one that the driver filtered, and the pose by tf."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    frame, store = six_axis_run(*hidden, seed=seed), ros_types()[0]
    filtered = frame.assign(**{name: frame[name].rolling(25, min_periods=1).mean() for name in CHANNELS})
    messages = [*ros_messages(store.types, frame, tf=True)]
    for topic, kind, stamp, message in ros_messages(store.types, filtered, tf=True):
        if topic == "/ft/wrench":
            messages.append((f"{topic}_filtered", kind, stamp, message))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        write_messages(writer, store, sorted(messages, key=lambda message: message[2]))
