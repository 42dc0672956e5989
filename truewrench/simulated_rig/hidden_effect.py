"""Base classes of hidden effects, by where they act: scene, tool, sensor, bias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from truewrench.simulated_rig.mujoco_scene import Array, Scene, Track, Vector


class HiddenEffect(ABC):
    """A physical effect of the simulated rig that the model does not know.

    `id` is the catalogue's (FORMATS.md) where `catalogued`; the fields have the names and signs of its
    parameters there, for comparison with a diagnosis.
    """

    id: ClassVar[str]
    catalogued: ClassVar[bool] = True
    planar_only: ClassVar[bool] = False
    spatial_only: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    """Whether it has no effect in static poses."""

    def placed(self, track: Track) -> Self:
        """The effect with unset locations and times resolved for the record of `track`."""
        return self


class SceneChange(HiddenEffect):
    """An effect that changes the MuJoCo model."""

    @abstractmethod
    def changed(self, scene: Scene) -> Scene:
        """The scene with the effect in it."""


class ToolLoad(HiddenEffect):
    """A force and a torque on the tool at the distance `d` (m) along the tip, in six axes `x` and `y` beside it."""

    d: float
    x: float = 0.0
    y: float = 0.0

    def point(self, scene: Scene) -> Vector:
        """The point of application in the tool's frame, m."""
        return scene.point(self.x, self.y, self.d)

    @abstractmethod
    def push(self, track: Track) -> tuple[Array, Array]:
        """Force (N) at the point and torque (N m) about it, on the tool, in the world, each (N, 3)."""


class TransientEffect(HiddenEffect):
    """An effect on a part of the record only; also a SceneChange or a ToolLoad."""

    needs_motion = True

    @abstractmethod
    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """Mask of the samples where it acts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorSignal:
    """A wrench signal in the measurement chain.

    record (N, p); before (M, p) the period of the motion before the record; step between samples, s.
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

    def mapped(self, memoryless: Any) -> SensorSignal:
        """The signal after a memoryless function."""
        return replace(self, record=memoryless(self.record), before=memoryless(self.before))


class SensorEffect(HiddenEffect):
    """An effect between the wrench and the reading; `order` is its position in the chain."""

    order: ClassVar[int]
    has_memory: ClassVar[bool] = False

    @abstractmethod
    def through(self, signal: SensorSignal) -> SensorSignal:
        """The signal after the effect."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleConditions:
    """Time (s) and true temperature (°C) of each sample, and channel names."""

    time: Array
    temperature: Array
    channels: tuple[str, ...]

    def amounts(self, force: float, torque: float) -> Array:
        """One number for each force channel (N) and one for each torque channel (N m)."""
        return np.where([c.startswith("f") for c in self.channels], force, torque)


class BiasEffect(HiddenEffect):
    """An additive effect on the bias of the readings."""

    @abstractmethod
    def shift(self, conditions: SampleConditions, rng: np.random.Generator) -> Array:
        """Bias shift (N, p), N and N m."""
