"""The upper bound with its dual, design measure and kind (proven or checked)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import exp

import numpy as np
from numpy.typing import NDArray

from design.bound.branch_and_bound import BranchAndBoundResult
from design.bound.column_generation import GenerationRound
from design.bound.dual_function import DualFunction, DualVariables
from design.bound.multistart_ascent import DualMaximum
from design.bound.weak_duality import WeakDuality
from design.trajectories.trajectory import Trajectory
from modeling.table import Table, Tabular

Array = NDArray[np.float64]
STATE_NAMES = ("q", "dq", "ddq")


class BoundKind(Enum):
    """Basis of the bound: a rigorous enclosure of F over all viable states, or a search for its largest value."""

    PROVEN = "proven"
    CHECKED = "checked"


@dataclass(frozen=True, eq=False, kw_only=True)
class DualityBound(Tabular):
    """An upper bound on ln det of N times the time mean of Phi'Phi, of any periodic trajectory within the limits.

    For D positive definite, ln det M <= -ln det D + tr(D M) - k. Along a periodic trajectory the mean of L h vanishes,
    so that with M = mean Phi'Phi, tr(D M) = mean F <= max F over the viable states. The best multiple of (D, c) makes
    this ln det M <= -ln det D + k ln(max F / k), and N M adds k ln N. Position, velocity and acceleration limits are
    used; a workspace, limits of jerk, the period and the bandwidth are not, which leaves the bound valid. It also holds
    for trajectories that start and end at rest in one posture: they meet all periodicity conditions too.

    It bounds the mean over time. N equally spaced samples are a quadrature of it: `weak_duality(motion)` gives its
    error.

    logdet        the bound; `kind`: proven or checked
    checked       the bound from the largest F found
    proven        the bound from the rigorous enclosure of F; None where none was made
    primal_value  the least bound that any dual for these conditions can give, to within rounding
    function      F, with the conditions' names; dual: its variables, so scaled that the largest F found is k
    states        (m, 3n) and weights (m,): support of the optimal design measure under these conditions
    """

    logdet: float
    kind: BoundKind
    checked: float
    proven: float | None
    primal_value: float
    samples: int
    function: DualFunction
    dual: DualVariables
    largest: DualMaximum
    proof: BranchAndBoundResult | None
    states: Array
    weights: Array
    rounds: tuple[GenerationRound, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the k parameters."""
        return tuple(p.name for p in self.function.experiment.parameters)

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the functions h."""
        return self.function.conditions.names

    def efficiency(self, logdet: float) -> float:
        """(det M / det M_bound)^(1/k): the share of the samples that the bound would need."""
        return exp((logdet - self.logdet) / len(self.parameters))

    def weak_duality(self, motion: Trajectory) -> WeakDuality:
        """Weak duality checked along one trajectory, and the quadrature error of its samples."""
        return WeakDuality.of(self.function, self.dual, motion, self.samples)

    @property
    def table(self) -> Table:
        """The bound, its conditions, and what is checked and proven."""
        return Table.of(("", ""), self.rows)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Names and values of the table."""
        return [
            ("upper bound of ln det", f"{self.logdet:.3f} ({self.kind.value}), {self.samples} samples"),
            ("primal value under these conditions", f"{self.primal_value:.3f}"),
            ("parameters", ", ".join(self.parameters)),
            ("periodicity conditions", f"{len(self.conditions)}, in {len(self.rounds)} rounds"),
            ("optimal design measure", self._measure()),
            ("checked", self._checked()),
            ("proven", self._proven()),
        ]

    def _measure(self) -> str:
        limits = self.function.viable.limits
        pairs = np.vstack([limits.position, limits.velocity, limits.acceleration])
        middle, half = pairs.mean(axis=1), np.ptp(pairs, axis=1) / 2
        shares = np.sqrt(self.weights @ ((self.states - middle) / half) ** 2).reshape(3, -1)
        texts = (f"{name} {', '.join(f'{s:.2f}' for s in row)}" for name, row in zip(STATE_NAMES, shares, strict=True))
        return f"{len(self.weights)} states; rms in shares of the limits: {'; '.join(texts)}"

    def _checked(self) -> str:
        search = f"{self.largest.ascents} ascents from the best of {self.largest.starts} random starts"
        return f"{self.checked:.3f}, if no viable state has a larger F than those found by {search}"

    def _proven(self) -> str:
        theory = "weak duality, and the viable set"
        if self.proof is None or self.proven is None:
            return f"{theory}; the largest F is not"
        return f"{self.proven:.3f}, {self.proof}; {theory}"
