"""Largest: the largest F of all viable states, as far as a search that knows nothing of the master finds it."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import Dual, DualFunction
from design.bound.search import Peaks, ascended, search, starts

Array = NDArray[np.float64]

STARTS_PER_ASCENT = 4
"""The best of so many starts is followed; of more, the highest peaks draw all ascents and narrow ones are missed."""
STEPS = 50
"""Of an ascent: more gain little, and the best are refined."""
REFINED, LONG = 40, 400
"""The best of them, followed until they no longer rise."""


@dataclass(frozen=True, eq=False)
class Largest:
    """The ends of all ascents, the best of them followed farther, and from how many random starts they were chosen."""

    peaks: Peaks
    starts: int

    @property
    def value(self) -> float:
        """The largest F found."""
        return float(self.peaks.value.max())

    @property
    def ascents(self) -> int:
        """How many ascents were made."""
        return len(self.peaks)


def largest(
    function: DualFunction,
    dual: Dual,
    support: Array,
    rng: np.random.Generator,
    *,
    count: int,
    executor: Executor | None = None,
) -> Largest:
    """The largest F from `count` new random starts, and from points (N, 2n) of the cube where it may be large."""
    points = np.vstack([starts(function.joints, count, rng), support])
    found = search(function, dual, points, keep=count // STARTS_PER_ASCENT, steps=STEPS, executor=executor)
    order = np.argsort(-found.value)
    refined = ascended(function, found.chosen(order[:REFINED]), dual, LONG)
    return Largest(refined.joined(found.chosen(order[REFINED:])), count)
