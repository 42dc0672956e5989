"""Frame evidence: whether the weight in the readings fits the orientation as it was read, or another reading of it.

A tool's force turns with the sensor: f = B R' (a + g e) + b with a constant e in the world, a the acceleration where
the position is known, B free (3 x 3: mass, mounting, signs) and b the zero. The residual of this fit is compared for
the orientation as read, with gravity along z, and for what is often mistaken: a quaternion w first, the inverse
rotation, a base mounted sideways, readings along base axes. All have equally many parameters, so that the smallest
residual is the most likely.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from estimation.logs.log_table import Array

GRAVITY = 9.806
W_FIRST = "the quaternion is w x y z"
STEP, LONGEST = 0.01, 20_000
"""Seconds between rows that are fitted, and the first rows of a recording among which they are."""
FEWEST = 50
CLEARLY = 0.5
"""Ratio of residuals from which another reading is the right one; readings that are right differ by less."""
LEAST_EXPLAINED = 0.6
"""Share of the readings' power that another reading has to explain."""
LEAST_WEIGHT = 0.2
"""Share of the readings' power below which a turning weight explains nothing."""
FLATTEST = 0.05
"""Smallest singular value of the directions of gravity in the sensor, of which three have to be seen."""


@dataclass(frozen=True, kw_only=True)
class FrameEvidence:
    """The orientation as read, and the best other reading of it; `force` is the std of the readings, N."""

    as_read: FrameReading
    best: FrameReading
    force: float

    @property
    def is_better(self) -> bool:
        """Whether the other reading is clearly the right one."""
        return self.best.rms < CLEARLY * self.as_read.rms and self.best.rms**2 < (1 - LEAST_EXPLAINED) * self.force**2

    @property
    def shows_no_weight(self) -> bool:
        """Whether no reading finds a weight that turns with the sensor, though it turns enough."""
        return min(self.as_read.rms, self.best.rms) ** 2 > (1 - LEAST_WEIGHT) * self.force**2


@dataclass(frozen=True, kw_only=True)
class FrameReading:
    """A reading of orientation and axes: what it means, what to do about it, the residual and mass that it gives.

    rms  N, of the forces; mass  kg, |det B|^(1/3)
    """

    meaning: str
    advice: str
    rms: float
    mass: float


def frame_evidence(columns: Mapping[str, Array]) -> FrameEvidence | None:
    """The evidence in a recording's columns (n,); None where gravity takes too few directions in the sensor."""
    samples = min(len(columns["fx"]), LONGEST)
    every = slice(0, samples, _stride(columns))
    force = np.stack([columns[name][every] for name in ("fx", "fy", "fz")], axis=1)
    quaternion = np.stack([columns[name][every] for name in ("qx", "qy", "qz", "qw")], axis=1)
    readings = _readings(force, quaternion, _acceleration(columns, every) / GRAVITY)
    as_read = next(readings)
    others = [reading for reading in readings if reading is not None]
    if as_read is None or not others:
        return None
    total = _least_squares(np.ones((len(force), 1)), force)[1]
    return FrameEvidence(as_read=as_read, best=min(others, key=lambda reading: reading.rms), force=total)


def quaternion_orders(columns: Mapping[str, Array]) -> tuple[FrameReading, FrameReading]:
    """The orientation as read, and as a quaternion w first, however few directions gravity takes."""
    from scipy.spatial.transform import Rotation  # slow to import

    every = slice(0, min(len(columns["fx"]), LONGEST), _stride(columns))
    force = np.stack([columns[name][every] for name in ("fx", "fy", "fz")], axis=1)
    quaternion = np.stack([columns[name][every] for name in ("qx", "qy", "qz", "qw")], axis=1)
    up = _acceleration(columns, every) / GRAVITY + np.array([0.0, 0.0, 1.0])
    turns = (Rotation.from_quat(quaternion), Rotation.from_quat(np.roll(quaternion, -1, axis=1)))
    first, second = (_fitted("", "", turn.apply(up, inverse=True), force, needed=False) for turn in turns)
    assert first is not None  # as it is not needed
    assert second is not None
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


def _readings(force: Array, quaternion: Array, a: Array) -> Iterator[FrameReading | None]:
    """The orientation as read, then the other readings of it; `a` is the acceleration (n, 3) in g."""
    from scipy.spatial.transform import Rotation  # slow to import

    turn, w_first = Rotation.from_quat(quaternion), Rotation.from_quat(np.roll(quaternion, -1, axis=1))
    x, y, z = np.eye(3)
    down = turn.apply(a + z, inverse=True)
    yield _fitted("as read", "", down, force, needed=False)
    yield _fitted(W_FIRST, 'state orientation = "wxyz" in a map', w_first.apply(a + z, inverse=True), force)
    yield _fitted(
        "the orientation is the world's in the sensor", "invert it before the import", turn.apply(a + z), force
    )
    for name, axis in (("x", x), ("y", y)):
        meaning = f"gravity points along {name} of the base"
        yield _fitted(meaning, "the base may be mounted sideways", turn.apply(a + axis, inverse=True), force)
    yield _fitted(
        "the wrench is along base axes", 'state wrench_axes = "base" in a map', down, turn.apply(force, inverse=True)
    )


def _fitted(meaning: str, advice: str, direction: Array, force: Array, *, needed: bool = True) -> FrameReading | None:
    """The fit of one reading; None where gravity takes too few directions in the sensor for it to mean anything."""
    centred = direction - direction.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(centred))
    if needed and spread[-1] < FLATTEST:
        return None
    solution, rms = _least_squares(np.hstack([GRAVITY * direction, np.ones((len(direction), 1))]), force)
    mass = float(abs(np.linalg.det(solution[:3])) ** (1 / 3))
    return FrameReading(meaning=meaning, advice=advice, rms=rms, mass=mass)


def _least_squares(regressors: Array, force: Array) -> tuple[Array, float]:
    solution = np.asarray(np.linalg.lstsq(regressors, force, rcond=1e-10)[0], dtype=np.float64)
    return solution, float(np.sqrt(np.mean((force - regressors @ solution) ** 2)))
