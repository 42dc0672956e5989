"""Simulated recordings."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from truewrench.simulated_rig.commanded_motion import CommandedMotion, PeriodicMotion
from truewrench.simulated_rig.geometric_effects import MIN_POINTS_PER_PERIOD, JointDeflection, TipFlexibility
from truewrench.simulated_rig.hidden_effect import (
    BiasEffect,
    HiddenEffect,
    SampleConditions,
    SceneChange,
    SensorEffect,
    SensorSignal,
    ToolLoad,
    TransientEffect,
)
from truewrench.simulated_rig.mujoco_scene import Array, Scene, States, Track, mujoco_rows
from truewrench.simulated_rig.rigs import SimulatedRig
from truewrench.simulated_rig.sensor_effects import NOISE_MODELS, NoiseModel, Saturation, TimeDelay


def true_wrench(rig: SimulatedRig, hidden: Sequence[HiddenEffect], drive: CommandedMotion) -> Array:
    """True wrench (N, p) of a rig in the sign convention of its readings, with the given hidden effects."""
    scene = rig.scene
    for effect in hidden:
        if isinstance(effect, SceneChange):
            scene = effect.changed(scene)
    states = drive.states
    for deflection in sorted((e for e in hidden if isinstance(e, JointDeflection)), key=lambda e: e.order):
        states = deflection.moved(scene, drive, states)
    loads = [effect for effect in hidden if isinstance(effect, ToolLoad)]
    tip = next((effect for effect in hidden if isinstance(effect, TipFlexibility)), None)
    if tip is None:
        wrench = rigid_tool_wrench(scene, loads, drive.time, states)
    else:
        wrench = _flexible_tip_wrench(tip, scene, loads, drive, states)
    return rig.sign * wrench[:, rig.rows]


def _flexible_tip_wrench(
    tip: TipFlexibility, rigid: Scene, loads: Sequence[ToolLoad], drive: CommandedMotion, states: States
) -> Array:
    """Wrench (N, 6) on a tool with a flexible tip for these states of the robot."""
    scene = tip.changed(rigid)

    def sensor_wrench(whole: States) -> Array:
        return rigid_tool_wrench(scene, loads, drive.time, whole)

    return sensor_wrench(tip.settled(scene, drive, states, sensor_wrench))


def rigid_tool_wrench(scene: Scene, loads: Sequence[ToolLoad], time: Array, states: States) -> Array:
    """The wrench (N, 6) that the sensor exerts on the tool, in the sensor's true axes, under the given loads.

    The first run gives the states of the points of application, the second the wrench with the loads. MuJoCo
    applies an external wrench at the body's centre of mass.
    """
    points = [load.point(scene) for load in loads]
    actual = (states[0] + scene.joint_offsets, states[1], states[2])
    rows = mujoco_rows(scene, points, actual, None)
    if not loads:
        return rows[:, :6]
    pushes = np.zeros((len(time), 6))
    for place, load in enumerate(loads):
        track = Track.of(rows, time, place)
        force, torque = load.push(track)
        pushes[:, :3] += force
        pushes[:, 3:] += torque + np.cross(track.point - track.centre, force)
    return mujoco_rows(scene, points, actual, pushes)[:, :6]


OVERSAMPLING = 10
"""Points per sample when an effect has dynamics: the input of a lag is linear between them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Simulation:
    """A rig with its hidden effects, selected by kind."""

    rig: SimulatedRig
    hidden: tuple[HiddenEffect, ...]

    def of(self, kind: type[Any]) -> list[Any]:
        """The effects of a kind, in the order given."""
        return [effect for effect in self.hidden if isinstance(effect, kind)]

    @property
    def delay(self) -> float:
        """The sum of all delays, s."""
        return float(sum(effect.delay for effect in self.of(TimeDelay)))

    def oversampling(self, samples_per_period: int) -> int:
        """Points per sample."""
        memory = OVERSAMPLING if any(effect.has_memory for effect in self.of(SensorEffect)) else 1
        swing = -(-MIN_POINTS_PER_PERIOD // samples_per_period) if self.of(TipFlexibility) else 1
        return max(memory, swing)

    def wrench(self, drive: CommandedMotion, events: Sequence[TransientEffect] = ()) -> Array:
        """True wrench (N, p), signs of the readings, with persistent effects and the given transient ones."""
        persistent = [effect for effect in self.hidden if not isinstance(effect, TransientEffect)]
        return true_wrench(self.rig, [*persistent, *events], drive)

    def with_events(self, wrench: Array, time: Array, motion: PeriodicMotion) -> Array:
        """Wrench of the record, recomputed where a transient effect is active."""
        events: list[TransientEffect] = self.of(TransientEffect)
        if not events:
            return wrench
        wrench = wrench.copy()
        active = np.stack([event.active(time) for event in events], axis=1)
        for pattern in np.unique(active, axis=0):
            if pattern.any():
                rows = (active == pattern).all(axis=1)
                present = [event for event, on in zip(events, pattern, strict=True) if on]
                wrench[rows] = self.wrench(CommandedMotion.along(motion, time[rows]), present)
        return wrench

    def through_sensor(self, signal: SensorSignal) -> Array:
        """The wrench (N, p) after gains, crosstalk, nonlinearity, play and lag, in this order."""
        for effect in sorted(self.of(SensorEffect), key=lambda e: int(e.order)):
            signal = effect.through(signal)
        return signal.record

    def readings(self, wrench: Array, conditions: SampleConditions, noise: NoiseModel, seed: int) -> Array:
        """Readings with bias, drifts, clipping and noise, each from an independent random stream."""
        noisy, *streams = np.random.default_rng(seed).spawn(1 + len(self.of(BiasEffect)))
        readings = wrench + np.array(self.rig.bias)
        for effect, stream in zip(self.of(BiasEffect), streams, strict=True):
            readings = readings + effect.shift(conditions, stream)
        for effect in self.of(Saturation):
            readings = effect.clipped(readings, np.array([c.startswith("f") for c in conditions.channels]))
        return np.asarray(readings + noise.draw(noisy, *readings.shape) * np.array(self.rig.noise))


def resolve_effects(
    rig: SimulatedRig, motion: PeriodicMotion, hidden: Sequence[HiddenEffect], *, repeats: int = 8
) -> tuple[HiddenEffect, ...]:
    """The effects as `simulate` uses them: unset locations and times resolved for path and record.

    Raises ValueError when an effect needs joints and the rig has none.
    """
    time = np.linspace(0.0, motion.period, 201)
    states = motion.evaluate(time)
    return tuple(
        _checked(rig, effect).placed(_over_all_repeats(_path(rig, effect, time, states), repeats)) for effect in hidden
    )


def simulate(
    rig: SimulatedRig,
    motion: PeriodicMotion,
    *,
    hidden: Sequence[HiddenEffect] = (),
    repeats: int = 8,
    samples_per_period: int = 1000,
    noise: NoiseModel | str = "white",
    seed: int = 0,
) -> pd.DataFrame:
    """Simulated recording of a periodic motion, repeated without pause.

    Parameters
    ----------
    rig : SimulatedRig
        `tw.simulated_rig.PlanarRig()` or `SpatialRig()`: a robot, a tool and a sensor in MuJoCo.
    motion : PeriodicMotion
        Its period, s, and its coordinates with derivatives: `rig.random_motion(seed=1)`, or a trajectory of `design`.
        It precedes the record too, so that lag and play are in their periodic state.
    hidden : sequence of HiddenEffect, optional
        What a rigid tool's model lacks, such as `tw.simulated_rig.ViscousDrag(c=0.15)`.
    repeats, samples_per_period : int, optional
        By default 8 and 1000.
    noise : NoiseModel or str, optional
        By default "white", of the rig's std.
    seed : int, optional
        Of the noise, which does not depend on the hidden effects.

    Returns
    -------
    pandas.DataFrame
        One row a sample: time (s, continuous), repeat, the rig's motion, its wrench channels (N, N m), temperature
        (°C), as a recording has them.

    Raises
    ------
    ValueError
        When motion, effects or counts do not suit the rig.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.simulated_rig.SpatialRig()
    >>> drag = tw.simulated_rig.ViscousDrag(c=0.6)
    >>> frame = tw.simulate(rig, rig.random_motion(seed=1), hidden=[drag], repeats=2, samples_per_period=200)
    >>> tw.from_dataframe(frame).repeats
    2
    """
    _check_counts(rig, motion, repeats, samples_per_period)
    _check_compatible(hidden)
    experiment = _Simulation(rig=rig, hidden=resolve_effects(rig, motion, hidden, repeats=repeats))
    fine = experiment.oversampling(samples_per_period)
    step = motion.period / (samples_per_period * fine)
    sensor_time = _ticks(repeats * samples_per_period * fine, step) - experiment.delay
    period = sensor_time[: samples_per_period * fine]
    before = experiment.wrench(CommandedMotion.along(motion, period, whole_period=True))
    record = experiment.with_events(np.tile(before, (repeats, 1)), sensor_time, motion)
    signal = SensorSignal(channels=rig.channels, record=record, before=before, step=step)
    wrench = experiment.through_sensor(signal)[::fine]

    time = _ticks(repeats * samples_per_period, motion.period / samples_per_period)
    q = rig.quantised(motion.evaluate(time[:samples_per_period])[0])
    columns = {name: np.tile(column, repeats) for name, column in rig.motion_columns(q).items()}
    head = {"time": time, "repeat": np.repeat(np.arange(repeats), samples_per_period)}
    return _frame(experiment, head | columns, wrench, time, _noise(noise), seed)


def static_poses(
    rig: SimulatedRig,
    poses: int | Array = 24,
    *,
    hidden: Sequence[HiddenEffect] = (),
    noise: NoiseModel | str = "white",
    seed: int = 0,
    seconds_per_pose: float = 10.0,
) -> pd.DataFrame:
    """Readings in static poses, one row each in the order of recording, no time column.

    poses is the number of random poses, or their coordinates (N, n); drift and warm-up continue between them.

    Raises ValueError when an effect needs motion or time (drag, lag, delay, friction, events, a tone).
    """
    for effect in hidden:
        if effect.needs_motion:
            raise ValueError(f"{effect.id} has no effect in static poses; simulate a motion")
    generator = np.random.default_rng([seed, 1])
    q = rig.random_poses(poses, generator) if isinstance(poses, int) else np.asarray(poses, dtype=float)
    if q.ndim != 2 or q.shape[1] != rig.coordinates:
        raise ValueError(f"poses of this rig have {rig.coordinates} coordinates; got an array of shape {q.shape}")
    time = _ticks(len(q), seconds_per_pose)
    drive = CommandedMotion.resting(q, time)
    placed = tuple(_checked(rig, e).placed(_path(rig, e, time, drive.states)) for e in hidden)
    experiment = _Simulation(rig=rig, hidden=placed)
    record = experiment.wrench(drive)
    signal = SensorSignal(channels=rig.channels, record=record, before=record[:1], step=seconds_per_pose)
    wrench = experiment.through_sensor(signal)
    return _frame(experiment, rig.motion_columns(rig.quantised(q)), wrench, time, _noise(noise), seed)


def write_recording(frame: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a recording as CSV with ten significant digits, atomically."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        frame.to_csv(temporary, index=False, float_format="%.10g")
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    return target


def _frame(
    experiment: _Simulation,
    columns: Mapping[str, npt.NDArray[Any]],
    wrench: Array,
    time: Array,
    noise: NoiseModel,
    seed: int,
) -> pd.DataFrame:
    rig = experiment.rig
    warm_up = rig.warm_up
    conditions = SampleConditions(time=time, temperature=warm_up.true(time), channels=rig.channels)
    readings = experiment.readings(wrench, conditions, noise, seed)
    thermometer = np.random.default_rng([seed, 2])
    logged = conditions.temperature + warm_up.noise * thermometer.standard_normal(len(time))
    named = dict(zip(rig.channels, readings.T, strict=True))
    return pd.DataFrame({**columns, **named, "temperature": logged})


def _ticks(count: int, step: float) -> Array:
    """`count` uniform sample times from zero, s."""
    return np.arange(count, dtype=np.float64) * np.float64(step)


def _checked(rig: SimulatedRig, effect: HiddenEffect) -> HiddenEffect:
    if effect.planar_only and not rig.scene.planar:
        raise ValueError(f"{effect.id} needs a planar rig with joints")
    if effect.spatial_only and rig.scene.planar:
        raise ValueError(f"{effect.id} does not show in the plane; simulate a six-axis rig")
    return effect


def _path(rig: SimulatedRig, effect: HiddenEffect, time: Array, states: States) -> Track:
    """Path of the effect's point of application, or of the sensor origin."""
    point = effect.point(rig.scene) if isinstance(effect, ToolLoad) else (0.0, 0.0, 0.0)
    return Track.of(mujoco_rows(rig.scene, (point,), states, None), time)


def _over_all_repeats(track: Track, repeats: int) -> Track:
    """The same path with times over all repeats: locations from one period, times from the record."""
    return replace(track, time=track.time * repeats)


def _noise(noise: NoiseModel | str) -> NoiseModel:
    if isinstance(noise, NoiseModel):
        return noise
    if noise not in NOISE_MODELS:
        raise ValueError(f"no noise model is called '{noise}'; use one of {', '.join(NOISE_MODELS)}")
    return NOISE_MODELS[noise]


def _check_counts(rig: SimulatedRig, motion: PeriodicMotion, repeats: int, samples_per_period: int) -> None:
    if repeats < 1 or samples_per_period < 2:
        raise ValueError(f"needs 1 repeat and 2 samples at least; got {repeats} and {samples_per_period}")
    coordinates = motion.evaluate(np.zeros(1))[0].shape[1]
    if coordinates != rig.coordinates:
        raise ValueError(f"the rig has {rig.coordinates} coordinates, the motion {coordinates}")


def _check_compatible(hidden: Sequence[HiddenEffect]) -> None:
    """Refuse a flexible tip with transient effects or a second one: only its periodic state is computed."""
    tips = [effect for effect in hidden if isinstance(effect, TipFlexibility)]
    events = [effect for effect in hidden if isinstance(effect, TransientEffect)]
    if tips and (events or len(tips) > 1):
        other = events[0].id if events else "another one"
        raise ValueError(f"{tips[0].id} cannot be simulated together with {other}; hide one of them")
