"""Bound: how good any motion within the limits can be, and what of that is proven."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import exp

import numpy as np
from numpy.typing import NDArray

from design.bound.along import AlongMotion, aligned
from design.bound.dual_function import Dual, DualFunction
from design.bound.generation import Round
from design.bound.largest import Largest
from design.bound.proof import Proof
from design.motion.series import Motion

Array = NDArray[np.float64]
ORDERS = ("q", "dq", "ddq")


class Kind(Enum):
    """What the number rests on: an enclosure of F over all viable states, or a search for its largest value."""

    PROVEN = "proven"
    CHECKED = "checked"


@dataclass(frozen=True, eq=False, kw_only=True)
class Bound:
    """An upper bound on ln det of N times the mean of Phi'Phi over time, of any periodic motion within the limits.

    For D positive definite, ln det M <= -ln det D + tr(D M) - k. Along a periodic motion the mean of L h vanishes, so
    that with M = mean Phi'Phi, tr(D M) = mean F <= max F over the viable states. The best multiple of (D, c) makes
    this ln det M <= -ln det D + k ln(max F / k), and N M adds k ln N. Position, velocity and acceleration limits
    are used; a workspace, limits of jerk, the period and the bandwidth are not, which leaves the bound valid. It holds
    as well for motions that start and end at rest in one posture: they too meet all conditions.

    It bounds the mean over time. N equally spaced samples are a quadrature of it: `along(motion)` says by how much
    they differ.

    logdet    the bound; `kind` says whether it is proven or checked
    checked   the bound that follows from the largest F found
    proven    the bound that follows from the rigorous enclosure of F; None where none was made
    reachable the least that any choice of multipliers for these conditions can give, to within rounding
    function  F, with the conditions' names; dual: its multipliers, so scaled that the largest F found is k
    states    (m, 3n) and weights (m,): the best measure under these conditions, where information would come from
    """

    logdet: float
    kind: Kind
    checked: float
    proven: float | None
    reachable: float
    samples: int
    function: DualFunction
    dual: Dual
    largest: Largest
    proof: Proof | None
    states: Array
    weights: Array
    rounds: tuple[Round, ...]

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

    def along(self, motion: Motion) -> AlongMotion:
        """What the dual says along one motion, and how far its samples are from its mean over time."""
        return AlongMotion.of(self.function, self.dual, motion, self.samples)

    def rows(self) -> list[tuple[str, str]]:
        """The table: what, and its value."""
        return [
            ("upper bound of ln det", f"{self.logdet:.3f} ({self.kind.value}), {self.samples} samples"),
            ("reachable with these conditions", f"{self.reachable:.3f}"),
            ("parameters", ", ".join(self.parameters)),
            ("conditions", f"{len(self.conditions)}, in {len(self.rounds)} rounds"),
            ("best measure", self._measure()),
            ("checked", self._checked()),
            ("proven", self._proven()),
        ]

    def _measure(self) -> str:
        limits = self.function.viable.limits
        pairs = np.vstack([limits.position, limits.velocity, limits.acceleration])
        middle, half = pairs.mean(axis=1), np.ptp(pairs, axis=1) / 2
        shares = np.sqrt(self.weights @ ((self.states - middle) / half) ** 2).reshape(3, -1)
        texts = (f"{name} {', '.join(f'{s:.2f}' for s in row)}" for name, row in zip(ORDERS, shares, strict=True))
        return f"{len(self.weights)} states; rms in shares of the limits: {'; '.join(texts)}"

    def _checked(self) -> str:
        looked = f"{self.largest.ascents} ascents from the best of {self.largest.starts} random starts"
        return f"{self.checked:.3f}, if no viable state has a larger F than {looked} and the master's states have found"

    def _proven(self) -> str:
        always = "weak duality, and the viable set"
        if self.proof is None or self.proven is None:
            return f"{always}; the largest F is not"
        return f"{self.proven:.3f}, {self.proof}; {always}"

    def __str__(self) -> str:
        return aligned(self.rows())
