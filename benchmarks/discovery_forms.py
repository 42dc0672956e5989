"""Forms that no catalogue has, as the simulated rig computes them: forces, torques, what sensors add to readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modeling.space import Space
from truewrench.simulated_rig import SensorEffect, SensorSignal, ToolLoad, Track

Array = NDArray[np.float64]
WARM, WARMING = 20.0, 8.0
"""°C: temperature, and by how much it changes over a recording."""


@dataclass(frozen=True, kw_only=True)
class Load(ToolLoad):
    """A force and a torque as functions of the track, times `size`."""

    id = "unlisted"
    catalogued = False
    needs_motion = True
    law: str
    size: float
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """In the world, at the point."""
        force, torque = LAWS[self.law](track)
        return self.size * force, self.size * torque


@dataclass(frozen=True, kw_only=True)
class Leak(SensorEffect):
    """A channel reads more by a function of the loads (n, p), times `size`."""

    id = "unlisted_leak"
    catalogued = False
    order = 1
    law: str
    size: float

    def through(self, signal: SensorSignal) -> SensorSignal:
        """Add it."""
        channel, law = OF_LOADS[self.law]
        unit = np.array([c == channel for c in signal.channels])
        return signal.mapped(lambda loads: loads + self.size * law(loads)[:, None] * unit)


def _force(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (law(track), np.zeros_like(track.point))


def _torque(law: Callable[[Track], Array]) -> Callable[[Track], tuple[Array, Array]]:
    return lambda track: (np.zeros_like(track.point), law(track))


def _size(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1, keepdims=True))


def _along(track: Track) -> Array:
    """Unit vectors along the tool's axis, in the world."""
    flat = track.point[:, 1].std() < 1e-6
    return np.asarray(track.turn.apply(np.array([0.0, -1.0, 0.0] if flat else [0.0, 0.0, 1.0])))


def _from_magnet(track: Track) -> Array:
    """Vectors to a place beside the simulated path, in the world."""
    return np.array(PLACES[track.point[:, 1].std() > 1e-6]) - track.point


def _depth(track: Track, level: float) -> Array:
    """How far (m) the point is below a level."""
    return np.asarray(np.maximum(0.0, level - track.point[:, 2:]))


PLACES = {False: (1.4, 0.0, 2.3), True: (0.24, 0.35, 0.17)}
"""In the plane, and in six axes, m: all motions pass it in 0.2 to 0.3 m."""
UP = np.array([0.0, 0.0, 1.0])

LAWS: Mapping[str, Callable[[Track], tuple[Array, Array]]] = {
    "cubic drag": _force(lambda t: -(_size(t.velocity) ** 2) * t.velocity),
    "fourth power": _force(lambda t: -(_size(t.velocity) ** 3) * t.velocity),
    "drag of power 1.5": _force(lambda t: -(_size(t.velocity) ** 0.5) * t.velocity),
    "drag of power 2.5": _force(lambda t: -(_size(t.velocity) ** 1.5) * t.velocity),
    "Magnus": _force(lambda t: np.cross(t.spin, t.velocity)),
    "lift": _force(lambda t: _size(t.velocity) * np.cross(_along(t), np.cross(_along(t), t.velocity))),
    "magnet": _force(lambda t: _from_magnet(t) / _size(_from_magnet(t)) ** 4),
    "charge": _force(lambda t: _from_magnet(t) / _size(_from_magnet(t)) ** 3),
    "stiffening spring": _force(lambda t: _from_magnet(t) * _size(_from_magnet(t)) ** 2),
    "eddy current": _force(lambda t: -t.velocity / _size(_from_magnet(t)) ** 3),
    "drag with height": _force(lambda t: -t.point[:, 2:] * t.velocity),
    "buoyancy": _force(lambda t: UP * np.minimum(_depth(t, 1.9), 0.2)),
    "spring below": _force(lambda t: UP * _depth(t, 1.9)),
    "viscous bath": _force(lambda t: -t.velocity * _depth(t, 1.9)),
    "ground effect": _force(lambda t: UP * np.exp(-(t.point[:, 2:] - 1.5) / 0.25)),
    "saturating drag": _force(lambda t: -t.velocity / (0.5 + _size(t.velocity))),
    "radial": _force(lambda t: -t.point * np.array([1.0, 1.0, 0.0]) * _size(t.point * np.array([1.0, 1.0, 0.0]))),
    "rotor": _torque(lambda t: np.cross(_along(t), t.spin)),
    "cubic spin": _torque(lambda t: -(_size(t.spin) ** 2) * t.spin),
    "compass": _torque(lambda t: np.cross(_along(t), np.array([0.6, 0.8, 0.0]))),
    "rudder": _force(lambda t: np.cross(_along(t), t.velocity)),
    "centrifugal": _force(lambda t: np.cross(t.spin, np.cross(t.spin, t.point))),
}
OF_LOADS: Mapping[str, tuple[str, Callable[[Array], Array]]] = {
    "product of loads": ("fx", lambda y: y[:, 1] * y[:, -1]),
    "square of a load": ("fy", lambda y: y[:, 0] ** 2),
    "load by load": ("fy", lambda y: y[:, 0] * y[:, 1]),
}
"""Channel, and law of the loads (n, p), of what is added to its reading."""
READINGS: Mapping[str, tuple[str, Callable[[pd.DataFrame], Array]]] = {
    "seventh of a turn": ("fx", lambda f: np.sin(7 * f["q2"].to_numpy() + 0.4)),
    "joint squared": ("fy", lambda f: f["q3"].to_numpy() ** 2),
    "two joints": ("fy", lambda f: np.sin(f["q2"].to_numpy()) * f["q3"].to_numpy()),
    "warm zero": ("fy", lambda f: (f["temperature"].to_numpy() - WARM) ** 2),
    "air pressure": ("fx", lambda f: f["pressure"].to_numpy() ** 2),
    "warm-up": ("tau", lambda f: np.exp(-f["time"].to_numpy() / (0.2 * f["time"].max()))),
    "rate squared": ("tau", lambda f: np.gradient(f[["q1", "q2", "q3"]].sum(axis=1), f["time"]) ** 2),
    "joint rate squared": ("fx", lambda f: np.gradient(f["q3"], f["time"]) ** 2),
}
"""Channel and law of what is added to a reading."""

COLUMNS: Mapping[str, Callable[[Array], Array]] = {
    "temperature": lambda time: WARM + WARMING * (1 - np.exp(-2 * time / time.max())),
    "pressure": lambda time: 1.0 + 0.5 * np.sin(2 * np.pi * time / 7.3),
}
"""Other columns of a recording, of the time: a slow one, and one that is not of the motion's period."""

FORMS: Mapping[str, tuple[Space, tuple[str, ...]]] = {
    "cubic drag": (Space.PLANE, ("F = c |v|^2 v at d",)),
    "fourth power": (Space.PLANE, ("F = c |v|^3 v at d",)),
    "drag of power 1.5": (Space.PLANE, ("F = c |v|^0.5 v at d",)),
    "drag of power 2.5": (Space.PLANE, ("F = c |v|^1.5 v at d",)),
    "Magnus": (Space.PLANE, ("F = c v x w at d",)),
    "magnet": (Space.PLANE, ("F = c |n|^-4 n at d",)),
    "charge": (Space.PLANE, ("F = c |n|^-3 n at d",)),
    "stiffening spring": (Space.PLANE, ("F = c |n|^2 n at d",)),
    "eddy current": (Space.PLANE, ("F = c |n|^-3 v at d",)),
    "buoyancy": (Space.PLANE, ("F = c into_y up at d", "F = into_y k at d")),
    "spring below": (Space.PLANE, ("F = c under_y up at d",)),
    "viscous bath": (Space.PLANE, ("F = c under_y v at d",)),
    "ground effect": (Space.PLANE, ("F = c falling_y up at d",)),
    "saturating drag": (Space.PLANE, ("F = c v_sat at d",)),
    "seventh of a turn": (Space.PLANE, ("fx = harmonic(7 q2)", "fx = c sin(7 q2)", "fx = c cos(7 q2)")),
    "joint squared": (Space.PLANE, ("fy = c q3^2",)),
    "two joints": (Space.PLANE, ("fy = q3 harmonic(q2)", "fy = q3 c sin(q2)")),
    "rate squared": (Space.PLANE, ("tau = c |w|^2", "T = |w|^2 h")),
    "joint rate squared": (Space.PLANE, ("fx = c dq3^2",)),
    "product of loads": (Space.PLANE, ("fx = c fy tau",)),
    "square of a load": (Space.PLANE, ("fy = c fx^2",)),
    "load by load": (Space.PLANE, ("fy = c fx fy",)),
    "warm zero": (
        Space.PLANE,
        (
            "fy = c_1 (temperature - 23.5) + c_2 (temperature - 23.5)^2",
            "fy = c_1 (temperature - 23) + c_2 (temperature - 23)^2",
            "fy = c_1 (temperature - 24) + c_2 (temperature - 24)^2",
        ),
    ),
    "air pressure": (Space.PLANE, ("fx = c pressure^2", "fx = c_1 (pressure - 1) + c_2 (pressure - 1)^2")),
    "warm-up": (Space.PLANE, ("tau = c fading",)),
    "rotor": (Space.SPACE, ("T = w x h", "T = c w x e")),
    "cubic spin": (Space.SPACE, ("T = c |w|^2 w",)),
    "compass": (Space.SPACE, ("T = e x k",)),
    "rudder": (Space.SPACE, ("F = c v x e at d",)),
    "lift": (Space.SPACE, ()),
    "centrifugal": (Space.SPACE, ("F = c w x (w x r) at d",)),
    "radial": (Space.SPACE, ("F = c |rho| rho at d",)),
    "drag with height": (Space.SPACE, ("F = c z v at d", "F = c (r.up) v at d")),
}
"""Space and formulas of each form: where there are two, they are the same; none where the grammar has none."""
