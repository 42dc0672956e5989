"""Largest F over the viable states by multistart ascent from fresh starts, independent of the master."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables
from design.bound.multistart_ascent import (
    LocalMaxima,
    StoppingRule,
    local_maxima,
    projected_gradient_ascent,
    random_points,
)

Array = NDArray[np.float64]

STARTS_PER_ASCENT = 4
"""Starts of which the best begins an ascent; with more, the highest maxima attract all ascents and narrow ones are
missed."""
EVERY_ASCENT = StoppingRule(steps=50, gain_tolerance=1e-7, extrapolation=20.0)
"""From the fifth step on gains decrease: the remaining gain was less than ten times that of the last five steps in half
a million ascents, and twice that is allowed for."""
REFINED_ASCENTS = 40
REFINING_ASCENT = StoppingRule(steps=400, gain_tolerance=1e-8, extrapolation=20.0)
"""The best of them are continued to convergence."""


@dataclass(frozen=True, eq=False)
class DualMaximum:
    """Local maxima of all ascents, the best of them refined, and the number of random starts."""

    peaks: LocalMaxima
    starts: int

    @property
    def value(self) -> float:
        """The largest F found."""
        return float(self.peaks.value.max())

    @property
    def ascents(self) -> int:
        """The number of ascents."""
        return len(self.peaks)


def maximise_dual_function(
    function: DualFunction,
    dual: DualVariables,
    support: Array,
    rng: np.random.Generator,
    *,
    count: int,
    executor: Executor | None = None,
) -> DualMaximum:
    """The largest F from `count` new random starts, and from points (N, 2n) of the cube where it may be large."""
    points = np.vstack([random_points(function.joints, count, rng), support])
    keep = count // STARTS_PER_ASCENT
    found = local_maxima(function, dual, points, keep=keep, rule=EVERY_ASCENT, executor=executor)
    order = np.argsort(-found.value)
    refined = projected_gradient_ascent(function, found.chosen(order[:REFINED_ASCENTS]), dual, REFINING_ASCENT)
    return DualMaximum(refined.joined(found.chosen(order[REFINED_ASCENTS:])), count)
