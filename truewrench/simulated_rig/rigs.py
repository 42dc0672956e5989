"""Simulated rigs: planar arm and six-axis carriage with sensor and tool."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from design.trajectories.fourier import random_periodic_trajectory
from design.trajectories.trajectory import Trajectory
from truewrench.simulated_rig.mujoco_scene import (
    Array,
    Chain,
    ChainScene,
    Mount,
    Scene,
    States,
    Track,
    Vector,
    mujoco_rows,
)
from truewrench.simulated_rig.sensor_effects import WarmUpTemperature

PLANAR_CHANNELS = ("fx", "fy", "tau")
SPATIAL_CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True, kw_only=True)
class SimulatedRig(ABC):
    """A robot with sensor and tool: nominal description and simulation settings.

    bias and noise  one per channel, N and N m: bias of the readings and standard deviation of one
    sample
    gravity         m/s²
    resolver_step   resolution of recorded angles, rad
    convention      "on_tool", the wrench that the sensor exerts on the tool, or "on_sensor", its negative
    """

    mass: float
    bias: tuple[float, ...]
    noise: tuple[float, ...]
    gravity: float = 9.806
    resolver_step: float = 7.4e-6
    warm_up: WarmUpTemperature = field(default_factory=WarmUpTemperature)
    convention: str = "on_tool"

    channels: ClassVar[tuple[str, ...]]
    rows: ClassVar[tuple[int, ...]]

    def __post_init__(self) -> None:
        if self.convention not in ("on_tool", "on_sensor"):
            raise ValueError(f"a rig's convention is on_tool or on_sensor; got '{self.convention}'")
        for name, values in (("bias", self.bias), ("noise", self.noise)):
            if len(values) != len(self.channels):
                raise ValueError(f"{name} needs one value for each of {', '.join(self.channels)}; got {len(values)}")

    @property
    def sign(self) -> int:
        """Sign of the readings relative to the wrench on the tool."""
        return 1 if self.convention == "on_tool" else -1

    @property
    @abstractmethod
    def coordinates(self) -> int:
        """Number of coordinates of a motion of this rig."""

    @cached_property
    @abstractmethod
    def scene(self) -> Scene:
        """The nominal MuJoCo model of the rig."""

    @abstractmethod
    def quantised(self, q: Array) -> Array:
        """Coordinates (N, n) at the resolution of the resolvers."""

    @abstractmethod
    def motion_columns(self, q: Array) -> dict[str, Array]:
        """The recorded columns of the motion for recorded coordinates (N, n)."""

    @abstractmethod
    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> Trajectory:
        """A random periodic motion within the limits of the rig."""

    @abstractmethod
    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Coordinates (count, n) of random poses."""


def repeat_on_chain(
    tool: SimulatedRig, chain: Chain, mount: Mount, tip_length: float, states: States
) -> tuple[Array, Array]:
    """The tip (N, 3), m, world, and the wrench (N, p) that the sensor exerts on a rig's tool, carried by other joints.

    chain, mount   as of a `ChainScene`
    tip_length     m, from the sensor along the tip
    """
    scene = ChainScene(**vars(tool.scene) | {"links": ()}, chain=chain, mount=mount)
    along = tip_length * scene.tip_axis
    rows = mujoco_rows(scene, ((float(along[0]), float(along[1]), float(along[2])),), states, None)
    track = Track.of(rows, np.zeros(len(rows)))
    return track.point, track.wrench[:, tool.rows]


@dataclass(frozen=True, kw_only=True)
class PlanarRig(SimulatedRig):
    """The planar arm of chapter 22: n hinges in a vertical plane, clockwise positive, q1 from upright.

    link_lengths m; mass kg, mlg kg m (along the tip) and inertia kg m² (about the sensor origin) of the tool;
    channels fx, fy, tau with the signs of 22.8; limits of `random_periodic_trajectory` in rad, rad/s, rad/s², one for
    all joints or one each.
    """

    link_lengths: tuple[float, ...] = (1.0, 0.97, 0.4)
    mass: float = 0.9
    mlg: float = 0.063
    inertia: float = 0.0129
    bias: tuple[float, ...] = (15.0, 0.25, -1.33)
    noise: tuple[float, ...] = (0.15, 0.25, 0.012)
    position_limit: float | tuple[float, ...] = 1.2
    velocity_limit: float | tuple[float, ...] = 2.5
    acceleration_limit: float | tuple[float, ...] = 12.0

    channels = PLANAR_CHANNELS
    rows = (0, 1, 5)

    @property
    def coordinates(self) -> int:
        """The number of joints."""
        return len(self.link_lengths)

    @cached_property
    def scene(self) -> Scene:
        """The arm; only the inertia about e3 enters."""
        along = self.mlg**2 / self.mass
        return Scene(
            links=self.link_lengths,
            joint_offsets=np.zeros(self.coordinates),
            gravity=np.array([0.0, 0.0, -self.gravity]),
            mass=self.mass,
            first_moment=np.array([0.0, -self.mlg, 0.0]),
            inertia=np.diag([self.inertia, self.inertia - along, self.inertia]),
            tip_axis=np.array([0.0, -1.0, 0.0]),
        )

    def quantised(self, q: Array) -> Array:
        """Every angle to the resolver's step."""
        return np.round(q / self.resolver_step) * self.resolver_step

    def motion_columns(self, q: Array) -> dict[str, Array]:
        """q1 .. qn, rad."""
        return {f"q{j + 1}": q[:, j] for j in range(self.coordinates)}

    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> Trajectory:
        """Within the limits of the rig."""
        return random_periodic_trajectory(
            joints=self.coordinates,
            position=self.position_limit,
            velocity=self.velocity_limit,
            acceleration=self.acceleration_limit,
            harmonics=harmonics,
            period=period,
            seed=seed,
        )

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Uniform within the position limits."""
        limit = np.broadcast_to(self.position_limit, self.coordinates)
        return rng.uniform(-limit, limit, (count, self.coordinates))


@dataclass(frozen=True, kw_only=True)
class SpatialRig(SimulatedRig):
    """A tool moved in six degrees of freedom: coordinates x, y, z (m) of the sensor and three angles (rad).

    Intrinsic rotations about x, y, z: R = Rx Ry Rz. first_moment (kg m) and
    inertia (kg m²: xx, xy, xz, yy, yz, zz) of the tool about the sensor origin in its frame; channels fx ..
    tz; limits of `random_periodic_trajectory` for (a position, an angle); positions are recorded in steps of
    `position_step` m.
    """

    mass: float = 1.2
    first_moment: Vector = (0.010, -0.018, 0.085)
    inertia: tuple[float, ...] = (0.0125, 0.0004, -0.0009, 0.0117, 0.0011, 0.0042)
    bias: tuple[float, ...] = (1.5, -0.8, 3.0, 0.12, -0.2, 0.05)
    noise: tuple[float, ...] = (0.06, 0.06, 0.08, 0.004, 0.004, 0.003)
    position_step: float = 1e-6
    position_limit: tuple[float, float] = (0.3, 1.3)
    velocity_limit: tuple[float, float] = (0.9, 2.5)
    acceleration_limit: tuple[float, float] = (6.0, 14.0)

    channels = SPATIAL_CHANNELS
    rows = (0, 1, 2, 3, 4, 5)

    @property
    def coordinates(self) -> int:
        """Six."""
        return 6

    @cached_property
    def scene(self) -> Scene:
        """The carriage and its tool."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return Scene(
            links=(),
            joint_offsets=np.zeros(6),
            gravity=np.array([0.0, 0.0, -self.gravity]),
            mass=self.mass,
            first_moment=np.array(self.first_moment),
            inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
            tip_axis=np.array([0.0, 0.0, 1.0]),
        )

    def quantised(self, q: Array) -> Array:
        """Positions and angles to their steps."""
        steps = np.repeat([self.position_step, self.resolver_step], 3)
        return np.asarray(np.round(q / steps) * steps)

    def motion_columns(self, q: Array) -> dict[str, Array]:
        """qx .. qw and px .. pz of the sensor in the world, by MuJoCo; the quaternion's sign is
        continuous.
        """
        track = Track.of(
            mujoco_rows(self.scene, ((0.0, 0.0, 0.0),), (q, np.zeros_like(q), np.zeros_like(q)), None), np.zeros(len(q))
        )
        quaternions = track.turn.as_quat()
        flips = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
        quaternions[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0))[:, None]
        names = ("qx", "qy", "qz", "qw", "px", "py", "pz")
        return dict(zip(names, np.hstack([quaternions, track.origin]).T, strict=True))

    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> Trajectory:
        """Within the limits of the rig; the angles are large enough for three independent directions of gravity."""
        return random_periodic_trajectory(
            joints=6,
            position=np.repeat(self.position_limit, 3),
            velocity=np.repeat(self.velocity_limit, 3),
            acceleration=np.repeat(self.acceleration_limit, 3),
            harmonics=harmonics,
            period=period,
            seed=seed,
        )

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Orientations uniform over the rotations, positions within the limit."""
        angles = Rotation.random(count, rng=rng).as_euler("XYZ")
        reach = self.position_limit[0]
        return np.hstack([rng.uniform(-reach, reach, (count, 3)), angles])
