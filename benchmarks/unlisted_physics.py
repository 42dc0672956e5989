"""Physics that no catalogue has, as loads on the simulated tool: textbook mechanics, without an equation of the models.

Each is computed along one period of the motion, in whose periodic steady state a record is.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truewrench.simulated_rig import HiddenEffect, Magnet, ToolLoad, Track

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.806])


@dataclass(frozen=True, kw_only=True)
class GearRipple(ToolLoad):
    """A driven tool whose gear pulls sideways, `force` (N) at `teeth` periods a turn about the tool's axis."""

    id = "gear_ripple"
    catalogued = False
    force: float = 0.3
    teeth: int = 30
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Along the tool's first axis."""
        angle = np.unwrap(track.turn.as_euler("XYZ")[:, 2])
        size = self.force * np.sin(self.teeth * angle)
        return track.turn.apply(np.outer(size, [1.0, 0.0, 0.0])), np.zeros_like(track.point)


@dataclass(frozen=True, kw_only=True)
class DahlFriction(ToolLoad):
    """A dragging hose: friction of `level` (N) that builds up over `stiction` (m) of its way (Dahl)."""

    id = "dahl_friction"
    catalogued = False
    level: float = 0.5
    stiction: float = 0.03
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the way that was made last: z' = v - |v| z / stiction, after a period that comes to no account."""
        steps = np.diff(track.point, axis=0, prepend=track.point[-1:])
        stretch, force = np.zeros(3), np.zeros_like(track.point)
        for step in steps:
            stretch = stretch + step - np.linalg.norm(step) / self.stiction * stretch
        for row, step in enumerate(steps):
            stretch = stretch + step - np.linalg.norm(step) / self.stiction * stretch
            force[row] = -self.level / self.stiction * stretch
        return force, np.zeros_like(force)


@dataclass(frozen=True, kw_only=True)
class Sloshing(ToolLoad):
    """A liquid of `mass` (kg) that swings across the tool's axis at `frequency` (Hz) with a damping ratio.

    At rest beside the tool it belongs to its mass; what is added is its acceleration relative to the tool.
    """

    id = "sloshing"
    catalogued = False
    mass: float = 0.3
    frequency: float = 1.5
    damping: float = 0.05
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Minus mass times x'', of x'' + 2 damping omega x' + omega² x = the apparent gravity across the axis."""
        step = track.time[1] - track.time[0]
        across = _apparent_gravity(track) * [1.0, 1.0, 0.0]
        s = 2j * np.pi * np.fft.rfftfreq(len(across), step)
        own = 2 * np.pi * self.frequency
        response = s**2 / (s**2 + 2 * self.damping * own * s + own**2)
        relative = np.fft.irfft(np.fft.rfft(across, axis=0) * response[:, None], len(across), axis=0)
        return track.turn.apply(-self.mass * relative), np.zeros_like(relative)


@dataclass(frozen=True, kw_only=True)
class LooseBolt(ToolLoad):
    """A bolt of `mass` (kg) that slides across the tool's axis within `play` (m), and stops dead at its ends."""

    id = "loose_bolt"
    catalogued = False
    mass: float = 0.1
    play: float = 0.02
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Minus mass times its acceleration relative to the tool, and its weight's torque about the middle."""
        step = track.time[1] - track.time[0]
        apparent = _apparent_gravity(track)
        place, moved = self._slid(apparent[:, 0], step)
        axis, force = np.array([1.0, 0.0, 0.0]), apparent - np.outer(moved, [1.0, 0.0, 0.0])
        torque = np.cross(np.outer(place, axis), self.mass * force)
        return track.turn.apply(np.outer(-self.mass * moved, axis)), track.turn.apply(torque)

    def _slid(self, along: Array, step: float) -> tuple[Array, Array]:
        """Place (n,) and relative acceleration (n,), after a period that comes to no account."""
        place, speed, end = 0.0, 0.0, self.play / 2
        places, moved = np.zeros_like(along), np.zeros_like(along)
        for row in range(-len(along), len(along)):
            before = speed
            speed += along[row] * step
            place += speed * step
            if abs(place) > end:
                place, speed = float(np.sign(place)) * end, 0.0
            places[row], moved[row] = place, (speed - before) / step
        return places, moved


@dataclass(frozen=True, kw_only=True)
class AirJet(ToolLoad):
    """A nozzle in the world that blows through the middle of the path with `force` (N) in a beam of std `width` (m)."""

    id = "air_jet"
    catalogued = False
    force: float = 1.0
    width: float = 0.1
    direction: tuple[float, float, float] = (0.6, 0.8, 0.0)
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Along the beam, by the distance from its axis."""
        direction = np.array(self.direction)
        place = track.point - track.point.mean(axis=0)
        distance = np.linalg.norm(place - np.outer(place @ direction, direction), axis=1)
        size = self.force * np.exp(-0.5 * (distance / self.width) ** 2)
        return np.outer(size, direction), np.zeros_like(place)


@dataclass(frozen=True, kw_only=True)
class GuidingHand(ToolLoad):
    """A hand that guides the tool from `start` to `end`, shares of the record, with smooth random forces (rms, N)."""

    id = "guiding_hand"
    catalogued = False
    force: float = 12.0
    start: float = 0.1
    end: float = 0.9
    tones: tuple[float, ...] = field(default=(0.11, 0.23, 0.41, 0.67))
    seed: int = 0
    d: float = 0.15

    def push(self, track: Track) -> tuple[Array, Array]:
        """Tones of random phase and direction, in the world."""
        rng = np.random.default_rng([self.seed, 5])
        phase = rng.uniform(0, 2 * np.pi, (len(self.tones), 3))
        angle = 2 * np.pi * np.multiply.outer(track.time, self.tones)[:, :, None] + phase
        force = self.force * np.sqrt(2 / len(self.tones)) * np.sin(angle).sum(axis=1)
        share = track.time / track.time[-1]
        held = np.clip(20 * np.minimum(share - self.start, self.end - share), 0.0, 1.0)
        return held[:, None] * force, np.zeros_like(force)


UNLISTED: tuple[HiddenEffect, ...] = (GearRipple(), DahlFriction(), Sloshing(), LooseBolt(), AirJet(), Magnet())
"""What the diagnosis may not call explained."""


def _apparent_gravity(track: Track) -> Array:
    """Gravity less the acceleration of the point (n, 3), m/s², in the tool's axes; the record is one period."""
    step = track.time[1] - track.time[0]
    speed = np.concatenate([track.velocity[-1:], track.velocity, track.velocity[:1]])
    acceleration = (speed[2:] - speed[:-2]) / (2 * step)
    return np.asarray(track.turn.inv().apply(GRAVITY - acceleration))
