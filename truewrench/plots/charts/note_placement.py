"""Places of the short notes in a panel of matplotlib: beside what they name, off the lines and off each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 3.0
"""Pixels between the points of a line that a note keeps off."""
OUTSIDE, WRITTEN_OVER = 1e6, 1e4
"""Cost of a place that leaves the panel, and of one on another note, in points of a line."""


@dataclass(frozen=True)
class Place:
    """A place of a note: `at` in coordinates of its own, or as they are, and the offset in points from there."""

    offset: tuple[float, float]
    across: str
    up: str
    at: tuple[float, float] | None = None


AROUND_POINT = (
    Place((-8, 0), "right", "center"),
    Place((8, 0), "left", "center"),
    Place((0, 8), "center", "bottom"),
    Place((0, -8), "center", "top"),
    Place((-7, 6), "right", "bottom"),
    Place((-7, -6), "right", "top"),
    Place((7, 6), "left", "bottom"),
    Place((7, -6), "left", "top"),
)
CORNERS = tuple(
    Place((0, 0), across, up, ({"left": 0.008, "right": 0.995}[across], {"top": 0.97, "bottom": 0.03}[up]))
    for across, up in (("right", "top"), ("left", "top"), ("right", "bottom"), ("left", "bottom"))
)


def along_level(y: float) -> tuple[Place, ...]:
    """Above or below a horizontal line at a height, at its end, its beginning or between."""
    between = tuple(("center", x) for x in np.linspace(0.9, 0.1, 17).tolist())
    return tuple(
        Place((0, 2 if up == "bottom" else -2), across, up, (x, y))
        for across, x in (("right", 0.995), ("left", 0.008), *between)
        for up in ("bottom", "top")
    )


@dataclass(frozen=True)
class Note:
    """A note that is drawn, and where it may be, the best first."""

    text: Annotation
    places: tuple[Place, ...]

    @classmethod
    def at_first(cls, text: Annotation, places: tuple[Place, ...]) -> Note:
        """The note at its best place."""
        _move(text, places[0])
        return cls(text, places)


def place_notes(axes: Axes, notes: Sequence[Note]) -> None:
    """Move each note to the first place where nothing is written over, else to the one where the least is.

    The panel must have its final size.
    """
    if not notes:
        return
    lines = np.concatenate([*_points_of_lines(axes), np.empty((0, 2))])
    panel, taken = axes.get_window_extent(), list[Bbox]()
    for note in notes:
        costs = []
        for number, place in enumerate(note.places):
            _move(note.text, place)
            costs.append((_cost(note.text.get_window_extent(), panel, lines, taken), number))
        _move(note.text, note.places[min(costs)[1]])
        taken.append(note.text.get_window_extent())


def _move(text: Annotation, place: Place) -> None:
    if place.at is not None:
        text.xy = place.at
    text.set_position(place.offset)
    text.set(ha=place.across, va=place.up)


def _cost(box: Bbox, panel: Bbox, lines: Array, taken: Sequence[Bbox]) -> float:
    """Points of lines in the box, and much more for what is outside the panel or on another note."""
    low, high = np.array([box.x0, box.y0]), np.array([box.x1, box.y1])
    covered = float(((lines > low) & (lines < high)).all(axis=1).sum())
    leaves: bool = box.x0 < panel.x0 or box.x1 > panel.x1 + 1 or box.y0 < panel.y0 - 1 or box.y1 > panel.y1 + 1
    written_over = sum(bool(box.overlaps(other)) for other in taken)
    return covered + OUTSIDE * float(leaves) + WRITTEN_OVER * written_over


def _points_of_lines(axes: Axes) -> Iterator[Array]:
    """Points in pixels along every line and interval, close enough that no note is between two of them."""
    for line in axes.lines:
        yield _dense(line.get_transform().transform(line.get_xydata()))
    for collection in (c for c in axes.collections if isinstance(c, LineCollection)):
        for segment in collection.get_segments():
            yield _dense(axes.transData.transform(segment))


def _dense(points: Any) -> Array:
    known = np.asarray(points, dtype=np.float64)
    known = known[np.isfinite(known).all(axis=1)]
    if len(known) < 2:
        return known
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(known, axis=0).T))])
    at = np.arange(0.0, length[-1] + STEP, STEP)
    between = np.stack([np.interp(at, length, known[:, i]) for i in (0, 1)], axis=1)
    return np.concatenate([known, between])
