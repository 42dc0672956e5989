"""Play between a load and its reading, exactly, with its derivatives in the load and in its width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.operators.turning_points import Indices, TurningPoints

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Played:
    """A load after play of half-width w in each channel: it moves only when pushed, and stays within w of the load.

    While the load rises from a turning point at which the reading was y, the reading is max(y, load - w); while it
    falls, min(y, load + w). So every sample of it is w off the load, or off the turning point that pushed last, or on
    the load where it began; the derivatives are those of this value.
    """

    courses: tuple[Course, ...]

    @classmethod
    def of(cls, load: Array, width: Array, *, periodic: bool, smooth: bool = True) -> Played:
        """The play of half-widths (p,) on a load (n, p), both in the channels' units.

        `periodic`: the steady state of a load that repeats without pause. Otherwise the reading begins in the middle
        of the play, on the load; so does a periodic one that is never pushed, as only its past could tell. With
        `smooth` the load turns between its samples (see `TurningPoints`); without, at samples (poses at rest).

        Raises InputError on a width below zero.
        """
        if np.any(np.asarray(width) < 0):
            raise InputError(what=f"the half-width {np.min(width):g} is negative", where="play", remedy="make it >= 0")
        columns = np.ascontiguousarray(np.transpose(load), dtype=float)
        turns = (TurningPoints.of(column, periodic=periodic, smooth=smooth) for column in columns)
        return cls(tuple(Course.of(*each, periodic) for each in zip(columns, turns, map(float, width), strict=True)))

    @property
    def reading(self) -> Array:
        """The load after play, (n, p)."""
        return np.stack([course.reading for course in self.courses], axis=1)

    @property
    def by_width(self) -> Array:
        """Derivative of each reading in its own half-width, (n, p): -1 pushed up, +1 pushed down, 0 not pushed yet.

        At width 0 it is that for a width growing from there, against the direction of the load.
        """
        return np.stack([course.side for course in self.courses], axis=1)

    def through(self, series: Array) -> Array:
        """The change of the reading with a change of the load, (n, p, ...): a linear map, widths unchanged."""
        changed = np.empty(series.shape)
        for channel, course in enumerate(self.courses):
            changed[:, channel] = course.through(series[:, channel])
        return changed


@dataclass(frozen=True, eq=False)
class Course:
    """The play of one channel.

    reading  (n,)
    side     (n,), +1 where it is w above what pushed last, -1 below, 0 not pushed yet
    source   (n,), the turning point that pushed last; K where the load of the same sample does, -1 not pushed yet
    """

    reading: Array
    side: Array
    source: Indices
    turns: TurningPoints

    @classmethod
    def of(cls, load: Array, turns: TurningPoints, width: float, periodic: bool) -> Course:
        """That of a load (n,) with its turning points."""
        pushed = _Pushed.along(turns, width, load[0])
        if periodic:
            pushed = _Pushed.along(turns, width, pushed.reading[-1], pushed.side[-1], pushed.source[-1])
        stretch = np.searchsorted(turns.place, np.arange(len(load)), side="left")
        upwards = _directions(load, turns)[stretch]
        held = pushed.reading[stretch]
        touched = upwards * (load - held) >= width
        touched[0] &= periodic
        return cls(
            reading=np.where(touched, load - upwards * width, held),
            side=np.where(touched, -upwards, pushed.side[stretch]),
            source=np.where(touched, len(turns.place), pushed.source[stretch]),
            turns=turns,
        )

    def through(self, series: Array) -> Array:
        """The change of the reading with a change (n, ...) of the load: gathered from what pushed last."""
        changed = series.copy()
        changed[self.source < 0] = series[0]
        held = np.flatnonzero((self.source >= 0) & (self.source < len(self.turns.place)))
        used, place = np.unique(self.source[held], return_inverse=True)
        weights = self.turns.weights[used]
        weights = weights.reshape(*weights.shape, *([1] * (series.ndim - 1)))
        columns = range(weights.shape[1])
        tops = sum((weights[:, m] * series[self.turns.samples[used, m]] for m in columns), np.zeros(()))
        changed[held] = tops[place]
        return changed


@dataclass(frozen=True, eq=False)
class _Pushed:
    """Reading, side and source at the beginning and after each of the K turning points, (K + 1,)."""

    reading: Array
    side: Array
    source: Indices

    @classmethod
    def along(cls, turns: TurningPoints, width: float, reading: float, side: float = 0.0, source: int = -1) -> _Pushed:
        states = [(float(reading), float(side), int(source))]
        for number, (crest, height) in enumerate(zip(turns.crest.tolist(), turns.height.tolist(), strict=True)):
            pushes = crest * (height - states[-1][0]) >= width
            states.append((height - crest * width, -crest, number) if pushes else states[-1])
        readings, sides, sources = zip(*states, strict=True)
        return cls(np.array(readings), np.array(sides), np.array(sources, dtype=np.intp))


def _directions(load: Array, turns: TurningPoints) -> Array:
    """+1 where the load rises before each of the K turning points and after the last, -1 where it falls, (K + 1,)."""
    if not len(turns.crest):
        return np.array([-1.0 if load[-1] < load[0] else 1.0])
    return np.append(turns.crest, -turns.crest[-1])
