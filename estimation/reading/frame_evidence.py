"""Frame evidence: whether the weight in the readings fits the orientation as it was read, or another reading of it.

A tool's force turns with the sensor: f = m Q R' (a + g e) + b, a the acceleration where the position is known, with
an unknown mounting Q (`estimation/recordings/weight_fit.py`). It is fitted to the orientation as read, with gravity as
the rig has it or down, and to what is often mistaken: a quaternion w first, the inverse rotation, a base mounted in
another orientation, readings along base axes. All have about equally many parameters, so that the smallest residual is
the most likely; whether it is shown is tested so that an effect that is hidden in the readings does not decide.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.gravity.gravity_estimate import (
    FEWEST_POSES,
    TILT,
    WeightMoments,
    estimated_gravity,
    independent_samples,
    upright_direction,
)
from estimation.reading.log_reader import Array
from estimation.recordings.sign_convention import to_sensor_frame
from estimation.recordings.weight_fit import PulledTool, WeightFit, cable_instead, weight_fit
from modeling.kinematics.placement import Direction

GRAVITY = 9.806
W_FIRST = "the quaternion is w x y z"
STEP, LONGEST = 0.01, 20_000
"""Seconds between rows that are fitted, and the first rows of a recording among which they are."""
FEWEST = 50
"""Rows, fewer of which are poses rather than a motion that can be differentiated."""
LARGEST_ACCELERATION = 3.0
"""g, root mean square: an arm moves its sensor with less, so that more is in other units."""
LEAST_TURN = 0.02
"""Change of the quaternion below which the sensor stood still: 2 degrees."""


@dataclass(frozen=True, kw_only=True)
class FrameEvidence:
    """The orientation as read, and the best of so many other readings of it."""

    as_read: FrameReading
    best: FrameReading
    others: int

    @property
    def is_better(self) -> bool:
        """Whether the other reading is shown to be the right one."""
        return self.best.fit.is_shown_against(self.as_read.fit, self.others)

    @property
    def sentence(self) -> str:
        """What the other reading would give."""
        text = f"{self.best.meaning}: the mass is {self.best.mass:.3g} kg then, and the residual of the weight falls"
        return f"{text} from {self.as_read.rms:.3g} to {self.best.rms:.3g} N"

    @property
    def shows_no_weight(self) -> bool:
        """Whether in every reading most of the force is no weight that turns with the sensor."""
        return self.as_read.fit.shows_no_weight and (self.best.fit.shows_no_weight or not self.is_better)

    @property
    def weight_sentence(self) -> str:
        """How little of the force is a weight."""
        share = 100 * max(self.as_read.fit.explained, 0.0)
        text = (
            f"a weight that turns with the sensor would be that of {self.as_read.mass:.2g} kg, and {share:.2g} % of the"
        )
        return f"{text} force's power: compensated already, or hidden by contact"


@dataclass(frozen=True, kw_only=True)
class FrameReading:
    """A reading of orientation and axes: what it means, what to do about it, and the fit of the weight."""

    meaning: str
    advice: str
    fit: WeightFit

    @property
    def rms(self) -> float:
        """Of the residual force in one channel, N."""
        return self.fit.rms

    @property
    def mass(self) -> float:
        """The tool's, kg."""
        return self.fit.mass


def sampled_rows(columns: Mapping[str, Array]) -> slice:
    """The rows of a recording's columns that the evidence is taken from."""
    return slice(0, min(len(columns["fx"]), LONGEST), _stride(columns))


def frame_evidence(
    columns: Mapping[str, Array], direction: Direction | None = None, acceleration: Array | None = None
) -> FrameEvidence | None:
    """The evidence in a recording's columns (n,); None of a sensor that never turns.

    `direction` is that of gravity in base axes where the rig states it; else it is down, or another is estimated.
    `acceleration` (n, 3), m/s², of the sensor origin in base axes is derived from the position unless it is given.
    """
    every = sampled_rows(columns)
    force = np.stack([columns[name][every] for name in ("fx", "fy", "fz")], axis=1)
    quaternion = np.stack([columns[name][every] for name in ("qx", "qy", "qz", "qw")], axis=1)
    a = _acceleration(columns, every) if acceleration is None else acceleration[every]
    up = -np.array(upright_direction(3) if direction is None else direction)
    as_read, *others = _readings(force, quaternion, a / GRAVITY, up)
    if direction is None:
        named = [columns[name][every] for name in ("px", "py", "pz") if name in columns]
        position = np.stack(named, axis=1) if len(named) == 3 else None
        others += _free_direction(force, quaternion, a, position, at_rest="time" not in columns)
    if np.ptp(quaternion, axis=0).max() < LEAST_TURN:
        return None
    best = min(others, key=lambda reading: reading.rms)
    return FrameEvidence(as_read=as_read, best=best, others=len(others))


def quaternion_orders(
    columns: Mapping[str, Array], direction: Direction | None = None
) -> tuple[FrameReading, FrameReading]:
    """The orientation as read, and as a quaternion w first, however few directions gravity takes."""
    every = sampled_rows(columns)
    force = np.stack([columns[name][every] for name in ("fx", "fy", "fz")], axis=1)
    quaternion = np.stack([columns[name][every] for name in ("qx", "qy", "qz", "qw")], axis=1)
    up = _acceleration(columns, every) / GRAVITY - np.array(upright_direction(3) if direction is None else direction)
    turns = (to_sensor_frame(quaternion), to_sensor_frame(np.roll(quaternion, -1, axis=1)))
    first, second = (_fitted("", "", _turned(turn, up), force) for turn in turns)
    return first, second


def _stride(columns: Mapping[str, Array]) -> int:
    """Rows from one that is fitted to the next: the tool's weight needs no more than a hundred a second."""
    if "time" not in columns:
        return 1
    return max(int(STEP / float(columns["time"][1] - columns["time"][0])), 1)


def _acceleration(columns: Mapping[str, Array], every: slice) -> Array:
    """World acceleration (n, 3) of these rows by splines through the position; zero where it is not known."""
    from estimation.recordings.differentiation import spline_derivatives  # slow to import

    rows = len(columns["fx"][every])
    if not {"time", "px", "py", "pz"} <= set(columns) or rows < FEWEST:
        return np.zeros((rows, 3))
    position = np.stack([columns[name][every] for name in ("px", "py", "pz")], axis=1)
    instants = columns["time"][every]
    return spline_derivatives(position, float(instants[1] - instants[0])).second


def _readings(force: Array, quaternion: Array, a: Array, up: Array) -> Iterator[FrameReading]:
    """The orientation as read, then the other readings of it; `a` is the acceleration (n, 3) in g, `up` (3,) that of
    a rest."""
    turn, w_first = to_sensor_frame(quaternion), to_sensor_frame(np.roll(quaternion, -1, axis=1))
    from_sensor, down = turn.swapaxes(1, 2), _turned(turn, a + up)
    yield _fitted("as read", "", down, force)
    yield _fitted(W_FIRST, 'state orientation = "wxyz" in a map', _turned(w_first, a + up), force)
    inverse = "the orientation is the base's in the sensor"
    yield _fitted(inverse, 'state orientation_of = "base" in a map', _turned(from_sensor, a + up), force)
    yield _fitted("the wrench is along base axes", 'state wrench_axes = "base" in a map', down, _turned(turn, force))
    if np.sqrt(np.mean(a**2)) > LARGEST_ACCELERATION:
        unit = 'state units = { position = "mm" } in a map'
        yield _fitted("the positions are in millimetres", unit, _turned(turn, 1e-3 * a + up), force)


def _free_direction(
    force: Array, quaternion: Array, a: Array, position: Array | None, *, at_rest: bool
) -> Iterator[FrameReading]:
    """The reading with gravity's direction free, where it is identified and another; `a` in m/s², position in m."""
    if len(force) < FEWEST_POSES:
        return
    turn = to_sensor_frame(quaternion)
    moments = WeightMoments.of(turn, a, force, GRAVITY)
    gravity = estimated_gravity(moments, independent_samples(len(force), at_rest=at_rest), near_axis=TILT)
    if gravity.is_upright:
        return
    specific = (_turned(turn, a / GRAVITY - np.array(d)) for d in (gravity.direction, gravity.rival))
    free, rival = (_fitted("", "", along, force) for along in specific)
    if not free.fit.is_nearer_than(rival.fit):
        return
    if position is not None:
        upright, turned = (
            PulledTool.of(turn, position, a - GRAVITY * np.array(direction), force)
            for direction in (upright_direction(3), gravity.direction)
        )
        gravity = replace(gravity, cable=cable_instead(upright, turned))
    yield replace(free, meaning=gravity.meaning, advice=gravity.advice)


def _turned(turns: Array, vectors: Array) -> Array:
    """Vectors (n, 3) times rotation matrices (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", turns, vectors))


def _fitted(meaning: str, advice: str, direction: Array, force: Array) -> FrameReading:
    return FrameReading(meaning=meaning, advice=advice, fit=weight_fit(GRAVITY * direction, force))
