"""What can be hidden in a rig, by where it acts: in the scene, on the tool, in the sensor, at its zero."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from truewrench.simulated_rig.scene import Array, Scene, Track


class HiddenEffect(ABC):
    """A piece of physics that a rig has and nobody knows of.

    `id` is the catalogue's (FORMATS.md) where `catalogued`; the fields carry the names and signs of its
    parameters there, so that a diagnosis can be compared with them.
    """

    id: ClassVar[str]
    catalogued: ClassVar[bool] = True
    planar_only: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    """Has nothing to act on in poses at rest."""

    def placed(self, track: Track) -> Self:
        """The effect with its open places and times filled in, to suit the record of `track`."""
        return self


class SceneChange(HiddenEffect):
    """An effect that changes what MuJoCo builds."""

    @abstractmethod
    def changed(self, scene: Scene) -> Scene:
        """The scene with the effect in it."""


class ToolLoad(HiddenEffect):
    """A force and a torque on the tool at the distance `d` (m) along the tip."""

    d: float

    @abstractmethod
    def push(self, track: Track) -> tuple[Array, Array]:
        """Force (N) at the point and torque (N m) about it, on the tool, in the world, each (N, 3)."""


class Event(HiddenEffect):
    """An effect of a part of the record only; it is a SceneChange or a ToolLoad besides."""

    needs_motion = True

    @abstractmethod
    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """When it is there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """A wrench on its way through the sensor.

    record (N, p); before (M, p) one period of the motion that went on before the record; step s between
    samples.
    """

    channels: tuple[str, ...]
    record: Array
    before: Array
    step: float

    def forces(self) -> npt.NDArray[np.bool_]:
        """Which channels are forces."""
        return np.array([c.startswith("f") for c in self.channels])

    def amounts(self, force: float, torque: float) -> Array:
        """One number for each force channel (N) and one for each torque channel (N m)."""
        return np.where(self.forces(), force, torque)

    def mapped(self, memoryless: Any) -> Signal:
        """The signal after a function of the sample."""
        return replace(self, record=memoryless(self.record), before=memoryless(self.before))


class SensorEffect(HiddenEffect):
    """An effect between the wrench and the reading; `order` is its place in the chain."""

    order: ClassVar[int]
    has_memory: ClassVar[bool] = False

    @abstractmethod
    def through(self, signal: Signal) -> Signal:
        """The signal after it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Clock:
    """The time (s) and the true temperature (°C) of each sample, and the channels' names."""

    time: Array
    temperature: Array
    channels: tuple[str, ...]

    def amounts(self, force: float, torque: float) -> Array:
        """One number for each force channel (N) and one for each torque channel (N m)."""
        return np.where([c.startswith("f") for c in self.channels], force, torque)


class ZeroShift(HiddenEffect):
    """An effect that is added to the readings at the end."""

    @abstractmethod
    def shift(self, clock: Clock, rng: np.random.Generator) -> Array:
        """What is added, (N, p), N and N m."""
