"""Largest: the largest F of all viable states, as far as a search that knows nothing of the master finds it."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import Dual, DualFunction
from design.bound.search import Patience, Peaks, ascended, search, starts

Array = NDArray[np.float64]

STARTS_PER_ASCENT = 4
"""The best of so many starts is followed; of more, the highest peaks draw all ascents and narrow ones are missed."""
EACH = Patience(steps=50, still=1e-7, promise=20.0)
"""From the fifth step on ascents gain less and less: what remains was less than ten times the last five steps' gain in
half a million ascents, of which twice that is allowed for."""
REFINED = 40
TO_THE_TOP = Patience(steps=400, still=1e-8, promise=20.0)
"""The best of them are followed until they no longer rise."""


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
    keep = count // STARTS_PER_ASCENT
    found = search(function, dual, points, keep=keep, patience=EACH, executor=executor)
    order = np.argsort(-found.value)
    refined = ascended(function, found.chosen(order[:REFINED]), dual, TO_THE_TOP)
    return Largest(refined.joined(found.chosen(order[REFINED:])), count)
