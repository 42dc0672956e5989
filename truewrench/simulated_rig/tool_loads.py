"""External loads on the tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from truewrench.simulated_rig.hidden_effect import HiddenEffect, ToolLoad, TransientEffect
from truewrench.simulated_rig.mujoco_scene import Array, Track, Vector

CONTACT_EDGE = 0.01
"""Rise and fall time of a contact force, s."""


@dataclass(frozen=True, kw_only=True)
class ViscousDrag(ToolLoad):
    """-c v at (x, y, d): c in N s/m, the point in m."""

    id = "viscous_drag"
    needs_motion = True
    c: float = 0.15
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the velocity of the point."""
        return -self.c * track.velocity, np.zeros_like(track.velocity)


@dataclass(frozen=True, kw_only=True)
class QuadraticDrag(ToolLoad):
    """-c |v| v at (x, y, d): c in N s²/m², the point in m."""

    id = "quadratic_drag"
    needs_motion = True
    c: float = 0.08
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the velocity of the point, with the square of the speed."""
        speed = np.linalg.norm(track.velocity, axis=1, keepdims=True)
        return -self.c * speed * track.velocity, np.zeros_like(track.velocity)


def _sliding(velocity: Array, width: float) -> Array:
    """Direction of a velocity (n, 3), times the share of a dry friction that acts at its size."""
    size = np.linalg.norm(velocity, axis=1, keepdims=True)
    share = 1 - 2 / (1 + np.exp(np.minimum(2 * size / width, 700.0)))
    return np.asarray(np.divide(velocity, size, out=np.zeros_like(velocity), where=size > 0) * share)


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(ToolLoad):
    """Friction of a hose at the wrist: a torque of size `level` (N m) against the tool's rotation in the world.

    Its sign changes over `width` (rad/s).
    """

    id = "coulomb_friction"
    needs_motion = True
    level: float = 0.03
    width: float = 0.001
    d: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the angular velocity; zero at rest."""
        return np.zeros_like(track.spin), -self.level * _sliding(track.spin, self.width)


@dataclass(frozen=True, kw_only=True)
class TranslationalFriction(ToolLoad):
    """Dry friction of size `level` (N) against the velocity of the point (x, y, d), m.

    Its sign changes over `width` (m/s).
    """

    id = "translational_friction"
    needs_motion = True
    level: float = 0.4
    width: float = 0.001
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the velocity of the point; zero at rest."""
        direction = _sliding(track.velocity, self.width)
        return -self.level * direction, np.zeros_like(direction)


@dataclass(frozen=True, kw_only=True)
class BaseForce(ToolLoad):
    """`force` (N) at (x, y, d), m, and `torque` (N m) on the tool, both constant along the axes of MuJoCo's world.

    The force is (x, 0, y) of one in the plane, where the torque does not turn, and is no more than a bias.
    """

    id = "base_force"
    force: Vector = (0.9, 0.0, -1.2)
    torque: Vector = (0.0, 0.0, 0.0)
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """The same at every sample."""
        once = np.ones((len(track.time), 1))
        return once * self.force, once * self.torque


@dataclass(frozen=True, kw_only=True)
class SpinningRotor(ToolLoad):
    """A rotor with a constant angular momentum (N m s) along the tool's axes, by what the tool feels of turning it."""

    id = "spinning_rotor"
    spatial_only = True
    needs_motion = True
    momentum: Vector = (0.0, 0.01, 0.04)
    d: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """The momentum in the world changes as its tip moves; the rotor resists, and hands the opposite to the tool."""
        in_world = track.turn.apply(self.momentum)
        return np.zeros_like(in_world), -np.cross(track.spin, in_world)


@dataclass(frozen=True, kw_only=True)
class CableSpring(ToolLoad):
    """Tether: pulls the point (x, y, d) towards an anchor with k (distance - length), slack below `length`.

    k in N/m, the others in m; the anchor is x, y, z of MuJoCo's world (x, 0, y of a point in the plane).
    By default the anchor lies beyond the path and the tether is taut in half of the samples.
    """

    id = "cable_spring"
    k: float = 3.0
    anchor: Vector | None = None
    length: float | None = None
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def placed(self, track: Track) -> Self:
        """Beyond the path's far end by half of its length."""
        middle, direction, reach = _main_direction(track.point)
        anchor = self.anchor or _vector(middle + 2 * reach * direction)
        distance = np.linalg.norm(track.point - np.array(anchor), axis=1)
        length = float(np.median(distance)) if self.length is None else self.length
        return replace(self, anchor=anchor, length=length)

    def push(self, track: Track) -> tuple[Array, Array]:
        """Towards the anchor when taut, else zero."""
        if self.anchor is None or self.length is None:
            raise _unresolved(self)
        vector = np.array(self.anchor) - track.point
        distance = np.linalg.norm(vector, axis=1, keepdims=True)
        tension = self.k * np.maximum(distance - self.length, 0.0)
        return tension * vector / distance, np.zeros_like(vector)


@dataclass(frozen=True, kw_only=True)
class ContactEvent(ToolLoad, TransientEffect):
    """Contact wrench on the tool from `start` to `end` (s).

    By default it lasts a tenth of the record, from 55 % of it on.
    force (N) and torque (N m, about the point, by default the sensor origin) are the environment's on the tool in the
    sensor's nominal axes: in the plane (fcx, -fcy, 0) and (0, 0, tauc). They rise and fall over 10 ms, half of it
    before `start`.
    """

    id = "contact_event"
    force: Vector = (4.0, -2.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.3)
    start: float | None = None
    end: float | None = None
    d: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def placed(self, track: Track) -> Self:
        """A tenth of the record, from 55 % of it on."""
        start = track.instant(0.55) if self.start is None else self.start
        end = start + track.instant(0.1) if self.end is None else self.end
        return replace(self, start=start, end=end)

    def push(self, track: Track) -> tuple[Array, Array]:
        """In the tool's axes, scaled by the envelope."""
        envelope = self._envelope(track.time)[:, None]
        return envelope * track.turn.apply(self.force), envelope * track.turn.apply(self.torque)

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """Where the envelope is not zero."""
        return self._envelope(time) > 0

    def wrench(self, time: Array) -> Array:
        """Contact wrench (N, 6) in the tool's axes: force and torque about the point."""
        return np.asarray(self._envelope(time)[:, None] * np.array([*self.force, *self.torque]))

    def _envelope(self, time: Array) -> Array:
        if self.start is None or self.end is None:
            raise _unresolved(self)
        inside = np.minimum(time - self.start, self.end - time) / CONTACT_EDGE + 0.5
        return np.asarray(np.sin(np.clip(inside, 0.0, 1.0) * np.pi / 2) ** 2)


# Loads that are not in the catalogue of effects.


@dataclass(frozen=True, kw_only=True)
class Buoyancy(ToolLoad):
    """Buoyancy of a tool dipping into a bath: an upward force from 0 at the surface to `lift` (N) `depth` (m) below it.

    `level` (m, world height of the surface; default: the point's median height), at d (m).
    """

    id = "buoyancy"
    catalogued = False
    lift: float = 2.0
    level: float | None = None
    depth: float = 0.2
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def placed(self, track: Track) -> Self:
        """The surface at the median height."""
        return self if self.level is not None else replace(self, level=float(np.median(track.point[:, 2])))

    def push(self, track: Track) -> tuple[Array, Array]:
        """Upwards, proportional to the depth of the point."""
        if self.level is None:
            raise _unresolved(self)
        force = np.zeros_like(track.point)
        force[:, 2] = self.lift * np.clip((self.level - track.point[:, 2]) / self.depth, 0.0, 1.0)
        return force, np.zeros_like(force)


@dataclass(frozen=True, kw_only=True)
class Magnet(ToolLoad):
    """Attraction of the point at d by a magnet in the world, strength / distance³ (N m³).

    `place` in m in MuJoCo's world; default: `clearance` (m) beyond the far end of the path.
    """

    id = "magnet"
    catalogued = False
    strength: float = 0.02
    place: Vector | None = None
    clearance: float = 0.15
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def placed(self, track: Track) -> Self:
        """Beyond the far end of the path."""
        if self.place is not None:
            return self
        middle, direction, _ = _main_direction(track.point)
        far = track.point[np.argmax((track.point - middle) @ direction)]
        return replace(self, place=_vector(far + self.clearance * direction))

    def push(self, track: Track) -> tuple[Array, Array]:
        """Towards the magnet."""
        if self.place is None:
            raise _unresolved(self)
        vector = np.array(self.place) - track.point
        distance = np.linalg.norm(vector, axis=1, keepdims=True)
        return self.strength * vector / distance**4, np.zeros_like(vector)


@dataclass(frozen=True, kw_only=True)
class MagnusForce(ToolLoad):
    """Magnus force c (spin x velocity) at d; c in kg, d in m."""

    id = "magnus_force"
    catalogued = False
    needs_motion = True
    c: float = 0.06
    d: float = 0.12
    x: float = 0.0
    y: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Perpendicular to the velocity: it does no work."""
        return self.c * np.cross(track.spin, track.velocity), np.zeros_like(track.velocity)


def _unresolved(effect: HiddenEffect) -> ValueError:
    return ValueError(f"{effect.id} has no location or time yet: call `placed` first")


def _vector(values: Array) -> Vector:
    """A location in the world rounded to the micrometre, so that a point of the plane stays in it."""
    x, y, z = (round(float(v), 6) + 0.0 for v in values)
    return x, y, z


def _main_direction(path: Array) -> tuple[Array, Array, float]:
    """Mean of a path (N, 3), unit vector of its largest extent, and its extent in that direction, m."""
    middle = path.mean(axis=0)
    direction = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return middle, direction, float(((path - middle) @ direction).max())
