"""Values of the parameters that terms are not linear in: at which terms are scored, and steps and bounds from there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from diagnosis.discovery.grammar import Term
from diagnosis.discovery.leaves import (
    DISTANCE,
    EDGE,
    LENGTH,
    NARROWEST,
    PLACE,
    RATE,
    SCALES,
    SHAPES,
    SPEED,
    TIME,
    WIDTH,
    Leaf,
)
from estimation.fit import Fit

Array = NDArray[np.float64]

SEARCHED = {DISTANCE: 3, EDGE: 7, WIDTH: 2, **dict.fromkeys(PLACE, 16), SPEED: 3, RATE: 3, TIME: 4, LENGTH: 3}
"""Values of each parameter that a term is not linear in, at which it is scored before it is refined."""
MOST_PLACES, INNER_PLACES, OUTER_PLACES, PATH_POINTS = 250, 1600, 6, 200
"""Places at the most; those about the path to choose from, and for each axis those beyond; and points of the path."""
APART = 0.5
"""Least distance of two places in that from the path: a force like |n|^-4 n is in part the same at both."""


class ShapeGrid:
    """Shapes of terms given a fit.

    `ranges` are those (low, high) in which the parameters are sought, by name; that of an edge is by its axis.
    """

    def __init__(self, fit: Fit, leaves: Mapping[str, Leaf], ranges: Mapping[str, tuple[float, float]]) -> None:
        self._fit, self._leaves, self._ranges = fit, leaves, ranges

    def points(self, names: Sequence[str], term: Term) -> list[Mapping[str, float]]:
        """Shapes at which a term is scored; of a force at a point that depends on a place, for a point near the tip."""
        if not set(PLACE) & set(names):
            rows: Iterable[Sequence[float]] = product(*(self._values(name, term) for name in names))
        elif DISTANCE in names:
            rows = [(self._near_tip, *place) for place in self._places]
        else:
            rows = self._places
        return [dict(zip(names, map(float, row), strict=True)) for row in rows]

    @cached_property
    def _near_tip(self) -> float:
        low, high = self._ranges[DISTANCE]
        return low + (high - low) / SEARCHED[DISTANCE]

    @cached_property
    def _places(self) -> list[Sequence[float]]:
        """Places in the world, the closer to each other the nearer they are to the path: there a force changes most."""
        recording, names = self._fit.recordings[0], [name for name in PLACE if name in self._ranges]
        theta = np.array([self._near_tip if name == DISTANCE else float(name in SCALES) for name in SHAPES])
        axes = [self._leaves[axis].function for axis in self._fit.model.space.axes]
        signals, samples = recording.motion.model_signals, recording.samples_per_repeat
        path = np.hstack([axis.value(signals, theta, samples) for axis in axes])[:: max(1, samples // PATH_POINTS)]
        low, high = path.min(axis=0), path.max(axis=0)
        reach, count = self._ranges[DISTANCE][1], round(INNER_PLACES ** (1 / len(names)))
        meshes = [[np.linspace(a - reach, b + reach, count) for a, b in zip(low, high, strict=True)]]
        meshes += [[np.linspace(*self._ranges[name], OUTER_PLACES) for name in names]]
        places = np.vstack([np.stack(np.meshgrid(*mesh), axis=-1).reshape(-1, len(names)) for mesh in meshes])
        away = np.array([np.linalg.norm(path - place, axis=1).min() for place in places])
        places, away = places[np.argsort(away)], np.sort(away)
        spacing, chosen = APART, list[Sequence[float]]()
        while not chosen or len(chosen) > MOST_PLACES:
            radius, chosen = spacing * np.maximum(away, reach / 4), []
            free = away > reach / 8
            while free.any():
                first = int(np.argmax(free))
                chosen.append(places[first])
                free &= np.linalg.norm(places - places[first], axis=1) > np.minimum(radius, radius[first])
                free[first] = False
            spacing *= 1.2
        return chosen

    def _values(self, name: str, term: Term) -> Array:
        """Values of a parameter at which a term is scored: to the ends of a range, of an edge within it."""
        low, high = self._range(name, term)
        if name in (DISTANCE, WIDTH):
            return np.linspace(low, high, SEARCHED[name] + 1)[1:]
        if name in SCALES:
            return np.geomspace(low, high, SEARCHED[name])
        return np.linspace(low, high, SEARCHED[name] + 2)[1:-1]

    def _limits(self, name: str) -> tuple[float, float]:
        """Of a parameter in its refinement. A force far beyond the tool would be a torque."""
        if name == DISTANCE:
            return self._ranges[name]
        if name == LENGTH:  # exponentials stay finite
            return self._ranges[name][0] / 2, np.inf
        return (NARROWEST if name in SCALES else -np.inf), np.inf

    def _range(self, name: str, term: Term) -> tuple[float, float]:
        return self._ranges[edge_axis(term) if name == EDGE else name]

    def steps(self, term: Term, shapes: Mapping[str, float]) -> Array:
        """First steps of the refinement of shapes, towards the middle of their ranges."""
        low, high = np.array([self._range(name, term) for name in shapes]).T
        sizes = (high - low) / np.array([SEARCHED[name] for name in shapes]) / 2
        return np.asarray(np.where(np.array(list(shapes.values())) > (low + high) / 2, -sizes, sizes))

    def bounds(self, shapes: Mapping[str, float]) -> list[tuple[float, float]]:
        """Bounds in the refinement."""
        return [self._limits(name) for name in shapes]


def edge_axis(term: Term) -> str:
    """The coordinate of a term that begins at an edge."""
    return next(
        name.split("_")[1] for name in term.quantity.leaves if name.startswith(("over_", "under_", "onto_", "into_"))
    )
