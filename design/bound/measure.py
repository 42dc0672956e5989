"""Measure: what share of the time is best spent in which state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction
from design.bound.search import Peaks

Array = NDArray[np.float64]

SUPPORT = 0.99
"""Share of the measure that its heaviest states make up; the others are there for the barrier only."""


@dataclass(frozen=True, eq=False)
class Measure:
    """Points of the cube with ddq, their weights (N,), and the ln det of one sample that they give (`Master`)."""

    peaks: Peaks
    weights: Array
    lower: float

    def support(self, function: DualFunction) -> tuple[Array, Array]:
        """The heaviest states (m, 3n), and their weights (m,)."""
        order = np.argsort(-self.weights)
        share = np.cumsum(self.weights[order]) / self.weights.sum()
        heavy = order[: int(np.searchsorted(share, SUPPORT)) + 1]
        chosen, weights = self.peaks.chosen(heavy), self.weights[heavy]
        return function.states(chosen.points, chosen.ddq), weights / weights.sum()
