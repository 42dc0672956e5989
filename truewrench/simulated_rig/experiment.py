"""From a rig, a motion and what is hidden to a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from truewrench.simulated_rig.drive import Drive, PeriodicMotion
from truewrench.simulated_rig.flexible_tip import FINEST, TipFlexibility
from truewrench.simulated_rig.hidden import (
    Clock,
    Event,
    HiddenEffect,
    SensorEffect,
    Signal,
    ToolLoad,
    ZeroShift,
)
from truewrench.simulated_rig.noise import NOISE_MODELS, NoiseModel
from truewrench.simulated_rig.rigs import Rig
from truewrench.simulated_rig.scene import Array, States, Track, mujoco_rows
from truewrench.simulated_rig.sensor_effects import Saturation, TimeDelay
from truewrench.simulated_rig.true_wrench import true_wrench

OVERSAMPLING = 10
"""Points to a sample when an effect has memory: a lag's input is taken as straight between them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Experiment:
    """A rig with its hidden effects, sorted by where they act."""

    rig: Rig
    hidden: tuple[HiddenEffect, ...]

    def of(self, kind: type[Any]) -> list[Any]:
        """The effects of a kind, in the order given."""
        return [effect for effect in self.hidden if isinstance(effect, kind)]

    @property
    def delay(self) -> float:
        """The sum of all delays, s."""
        return float(sum(effect.delay for effect in self.of(TimeDelay)))

    def oversampling(self, samples_per_period: int) -> int:
        """Points to a sample."""
        memory = OVERSAMPLING if any(effect.has_memory for effect in self.of(SensorEffect)) else 1
        swing = -(-FINEST // samples_per_period) if self.of(TipFlexibility) else 1
        return max(memory, swing)

    def wrench(self, drive: Drive, events: Sequence[Event] = ()) -> Array:
        """The true wrench (N, p) in the signs of the readings, under lasting effects and the given events."""
        lasting = [effect for effect in self.hidden if not isinstance(effect, Event)]
        return true_wrench(self.rig, [*lasting, *events], drive)

    def with_events(self, wrench: Array, time: Array, motion: PeriodicMotion) -> Array:
        """The wrench of the whole record, computed anew where an event is active."""
        events: list[Event] = self.of(Event)
        if not events:
            return wrench
        wrench = wrench.copy()
        active = np.stack([event.active(time) for event in events], axis=1)
        for pattern in np.unique(active, axis=0):
            if pattern.any():
                here = (active == pattern).all(axis=1)
                present = [event for event, on in zip(events, pattern, strict=True) if on]
                wrench[here] = self.wrench(Drive.along(motion, time[here]), present)
        return wrench

    def through_sensor(self, signal: Signal) -> Array:
        """The wrench (N, p) after gains, crosstalk, nonlinearity, play and lag, in this order."""
        for effect in sorted(self.of(SensorEffect), key=lambda e: int(e.order)):
            signal = effect.through(signal)
        return signal.record

    def readings(self, wrench: Array, clock: Clock, noise: NoiseModel, seed: int) -> Array:
        """The readings: bias, drifts, clipping and noise added; each has a random stream of its own."""
        noisy, *streams = np.random.default_rng(seed).spawn(1 + len(self.of(ZeroShift)))
        readings = wrench + np.array(self.rig.bias)
        for effect, stream in zip(self.of(ZeroShift), streams, strict=True):
            readings = readings + effect.shift(clock, stream)
        for effect in self.of(Saturation):
            readings = effect.clipped(readings, np.array([c.startswith("f") for c in clock.channels]))
        return np.asarray(readings + noise.draw(noisy, *readings.shape) * np.array(self.rig.noise))


def placed(
    rig: Rig, motion: PeriodicMotion, hidden: Sequence[HiddenEffect], *, repeats: int = 8
) -> tuple[HiddenEffect, ...]:
    """The effects as `simulate` uses them: open places and times filled in to suit path and record.

    Raises ValueError when an effect needs joints and the rig has none.
    """
    time = np.linspace(0.0, motion.period, 201)
    states = motion.evaluate(time)
    return tuple(
        _checked(rig, effect).placed(_stretched(_path(rig, effect, time, states), repeats)) for effect in hidden
    )


def simulate(
    rig: Rig,
    motion: PeriodicMotion,
    *,
    hidden: Sequence[HiddenEffect] = (),
    repeats: int = 8,
    samples_per_period: int = 1000,
    noise: NoiseModel | str = "white",
    seed: int = 0,
) -> pd.DataFrame:
    """A recording of a periodic motion, repeated without pause, in the columns of FORMATS.md.

    Columns: time (s, running on), repeat, the rig's motion, its wrench channels, temperature (°C). The tool
    moved before the record in the same way, so that lag and play are in their periodic state. The same seed
    gives the same noise whatever is hidden.

    Raises ValueError when motion, effects or counts do not suit the rig.
    """
    _check_counts(rig, motion, repeats, samples_per_period)
    _check_together(hidden)
    experiment = _Experiment(rig=rig, hidden=placed(rig, motion, hidden, repeats=repeats))
    fine = experiment.oversampling(samples_per_period)
    step = motion.period / (samples_per_period * fine)
    seen = _ticks(repeats * samples_per_period * fine, step) - experiment.delay
    period = seen[: samples_per_period * fine]
    before = experiment.wrench(Drive.along(motion, period, whole_period=True))
    record = experiment.with_events(np.tile(before, (repeats, 1)), seen, motion)
    signal = Signal(channels=rig.channels, record=record, before=before, step=step)
    wrench = experiment.through_sensor(signal)[::fine]

    time = _ticks(repeats * samples_per_period, motion.period / samples_per_period)
    q = rig.quantised(motion.evaluate(time[:samples_per_period])[0])
    columns = {name: np.tile(column, repeats) for name, column in rig.motion_columns(q).items()}
    head = {"time": time, "repeat": np.repeat(np.arange(repeats), samples_per_period)}
    return _frame(experiment, head | columns, wrench, time, _noise(noise), seed)


def rest_poses(
    rig: Rig,
    poses: int | Array = 24,
    *,
    hidden: Sequence[HiddenEffect] = (),
    noise: NoiseModel | str = "white",
    seed: int = 0,
    seconds_per_pose: float = 10.0,
) -> pd.DataFrame:
    """Readings in poses at rest, one row each and no time column, in the order taken.

    poses is how many random ones, or the coordinates (N, n) themselves; drift and warm-up go on between them.

    Raises ValueError when an effect needs motion or time (drag, lag, delay, friction, events, a tone).
    """
    for effect in hidden:
        if effect.needs_motion:
            raise ValueError(f"{effect.id} does not exist in poses at rest; simulate a motion")
    generator = np.random.default_rng([seed, 1])
    q = rig.random_poses(poses, generator) if isinstance(poses, int) else np.asarray(poses, dtype=float)
    if q.ndim != 2 or q.shape[1] != rig.coordinates:
        raise ValueError(f"poses of this rig have {rig.coordinates} coordinates; got an array of shape {q.shape}")
    time = _ticks(len(q), seconds_per_pose)
    drive = Drive.resting(q, time)
    known = tuple(_checked(rig, e).placed(_path(rig, e, time, drive.states)) for e in hidden)
    experiment = _Experiment(rig=rig, hidden=known)
    record = experiment.wrench(drive)
    signal = Signal(channels=rig.channels, record=record, before=record[:1], step=seconds_per_pose)
    wrench = experiment.through_sensor(signal)
    return _frame(experiment, rig.motion_columns(rig.quantised(q)), wrench, time, _noise(noise), seed)


def write_recording(frame: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a recording as CSV, ten significant digits, beside its place first and then renamed into it."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        frame.to_csv(beside, index=False, float_format="%.10g")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target


def _frame(
    experiment: _Experiment,
    columns: Mapping[str, npt.NDArray[Any]],
    wrench: Array,
    time: Array,
    noise: NoiseModel,
    seed: int,
) -> pd.DataFrame:
    rig = experiment.rig
    warm_up = rig.warm_up
    clock = Clock(time=time, temperature=warm_up.true(time), channels=rig.channels)
    readings = experiment.readings(wrench, clock, noise, seed)
    thermometer = np.random.default_rng([seed, 2])
    logged = clock.temperature + warm_up.noise * thermometer.standard_normal(len(time))
    named = dict(zip(rig.channels, readings.T, strict=True))
    return pd.DataFrame({**columns, **named, "temperature": logged})


def _ticks(count: int, step: float) -> Array:
    """`count` times from zero on, s."""
    return np.arange(count, dtype=np.float64) * np.float64(step)


def _checked(rig: Rig, effect: HiddenEffect) -> HiddenEffect:
    if effect.planar_only and not rig.scene.planar:
        raise ValueError(f"{effect.id} needs a planar rig with joints")
    return effect


def _path(rig: Rig, effect: HiddenEffect, time: Array, states: States) -> Track:
    """The path of the point that the effect attacks, or of the sensor origin."""
    point = effect.d if isinstance(effect, ToolLoad) else 0.0
    return Track.of(mujoco_rows(rig.scene, (point,), states, None), time)


def _stretched(track: Track, repeats: int) -> Track:
    """The same path with times over all repeats: places come from one period, instants from the record."""
    return replace(track, time=track.time * repeats)


def _noise(noise: NoiseModel | str) -> NoiseModel:
    if isinstance(noise, NoiseModel):
        return noise
    if noise not in NOISE_MODELS:
        raise ValueError(f"no noise model is called '{noise}'; use one of {', '.join(NOISE_MODELS)}")
    return NOISE_MODELS[noise]


def _check_counts(rig: Rig, motion: PeriodicMotion, repeats: int, samples_per_period: int) -> None:
    if repeats < 1 or samples_per_period < 2:
        raise ValueError(f"needs 1 repeat and 2 samples at least; got {repeats} and {samples_per_period}")
    coordinates = motion.evaluate(np.zeros(1))[0].shape[1]
    if coordinates != rig.coordinates:
        raise ValueError(f"the rig has {rig.coordinates} coordinates, the motion {coordinates}")


def _check_together(hidden: Sequence[HiddenEffect]) -> None:
    """A tip that swings is known in its periodic state only, and swings once."""
    tips = [effect for effect in hidden if isinstance(effect, TipFlexibility)]
    events = [effect for effect in hidden if isinstance(effect, Event)]
    if tips and (events or len(tips) > 1):
        other = events[0].id if events else "another one"
        raise ValueError(f"{tips[0].id} cannot be simulated together with {other}; hide one of them")
