"""Column generation: states joined to the restricted master until the optimality gap closes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from math import log
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables
from design.bound.multistart_ascent import (
    DualMaximum,
    LocalMaxima,
    StoppingRule,
    local_maxima,
    maximise_dual_function,
    random_points,
)
from design.bound.restricted_master import DualCoordinates, RestrictedMaster
from design.bound.symmetry import Symmetry

Array = NDArray[np.float64]


SUPPORT_SHARE = 0.99
"""Share of the design measure in its support; the remaining states have weight from the barrier only."""


@dataclass(frozen=True, eq=False)
class DesignMeasure:
    """Optimal design measure: points of the cube with ddq, their weights (N,), and its ln det of one sample."""

    peaks: LocalMaxima
    weights: Array
    lower: float

    def support(self, function: DualFunction) -> tuple[Array, Array]:
        """The states of largest weight (m, 3n), and their weights (m,)."""
        order = np.argsort(-self.weights)
        share = np.cumsum(self.weights[order]) / self.weights.sum()
        support = order[: int(np.searchsorted(share, SUPPORT_SHARE)) + 1]
        chosen, weights = self.peaks.chosen(support), self.weights[support]
        return function.states(chosen.points, chosen.ddq), weights / weights.sum()


@dataclass(frozen=True, eq=False)
class CandidateDual:
    """A candidate dual, its bound of one sample, and the search for its largest F; None where not made yet."""

    dual: DualVariables
    upper: float
    largest: DualMaximum | None = None

    @classmethod
    def of(cls, dual: DualVariables, value: float, found: DualMaximum | None = None) -> CandidateDual:
        """The dual scaled so that the largest F, `value`, becomes k: then -ln det D is the bound."""
        scaled = dual.scaled(len(dual.D) / value)
        return cls(scaled, scaled.value, found)

    @property
    def starts(self) -> int:
        """Number of random starts of the search for the largest F."""
        return 0 if self.largest is None else self.largest.starts


RANDOM_STARTS_PER_DIMENSION = 800
"""New starts of a search for each dimension of (q, dq): four to an ascent, as in `maximise_dual_function`."""
FIRST_STATES_PER_DIMENSION = 600
"""States of the first master for each dimension: several to each condition."""
MOST_STATES = 20_000
"""Of the master; beyond, those of least weight are dropped. Every round adds some hundreds. States of small weight are
needed too: with 7000 retained, F rose from 6 to 100 on one rig where some had been dropped, and they displaced others
when they returned."""
SUPPORT_STARTS = 500
"""States of largest weight from which a search starts as well: F is largest near to them."""
ASCENTS_PER_DIMENSION, BRIEF_ASCENT = 200, StoppingRule(steps=25, gain_tolerance=1e-5)
"""Ascents of a search for each dimension, and their steps: a cut need not be the deepest; `maximise_dual_function`
is more thorough. Many ascents at once take little time and save rounds."""
FIRST_GAP = 1.0
"""The first gap between the barrier's two bounds, in ln det: about the distance of random states from the optimum."""
GAP_FACTOR = 0.4
"""Factor of the gap when the search finds little: a smaller one needs fewer rounds, each with more steps."""
STALL_GAPS = 1.5
"""The search has stalled when the round's bounds differ by less than this many gaps: one gap is the barrier's own."""
JOINING_MARGIN = 0.3
"""States are joined if F is above k minus this share of the gap: the next active constraints."""
PRELIMINARY_PART = 4
"""Divisor of the starts of a candidate's preliminary search: it refutes most of those that the full one refutes."""
STATE_DECIMALS = 3
"""Decimals in the cube to which joined states differ."""


@dataclass(frozen=True)
class GenerationRound:
    """One round, ln det of one sample: of the round's design measure (lower), bound of its dual (upper), best bound.

    `states` is the number of states in the master.
    """

    number: int
    lower: float
    upper: float
    best: float
    states: int


@dataclass(frozen=True, eq=False)
class ColumnGenerationResult:
    """The best dual, its largest F, the best design measure, and the rounds."""

    dual: DualVariables
    largest: DualMaximum
    measure: DesignMeasure
    rounds: tuple[GenerationRound, ...]


GenerationProgress = Callable[[GenerationRound], None]


@dataclass(eq=False)
class ColumnGeneration:
    """Rounds of: centre the restricted master, search for large F (pricing), join the states. ln det M of one sample.

    For any dual, -ln det D + k ln(max F / k) bounds ln det M if max F is the largest F of all viable states:
    (D, c) k / max F is feasible. Central duals, and a gap that narrows only when the search stalls, keep the rounds
    few: extreme duals of too few states oscillate. For a promising dual the largest F is searched from many new starts
    (`maximise_dual_function`); the states found are joined as well.
    """

    function: DualFunction
    symmetries: tuple[Symmetry, ...]
    rng: np.random.Generator
    tolerance: float
    starts: int
    executor: Executor | None = None
    progress: GenerationProgress | None = None

    def run(self, most: int) -> ColumnGenerationResult:
        """At most `most` rounds, or until the optimality gap is below the tolerance."""
        (master, peaks), gap = self._first(), FIRST_GAP
        measure = DesignMeasure(peaks, np.ones(len(peaks)), -np.inf)
        candidates, rounds = list[CandidateDual](), list[GenerationRound]()
        for number in range(1, most + 1):
            master = master.centred(gap / len(peaks))
            current, dual = self._measure(master, peaks, gap), master.coordinates.dual(master.z)
            found = self._priced(dual, current)
            candidates.append(CandidateDual.of(dual, float(found.value.max())))
            upper, measure = candidates[-1].upper, max(measure, current, key=attrgetter("lower"))
            found = self._verified(candidates, found, peaks, measure.lower + self.tolerance)
            rounds.append(self._round(number, current, upper, _best(candidates).upper))
            if _best(candidates).upper < measure.lower + self.tolerance:
                break
            if upper - current.lower < STALL_GAPS * gap:
                gap = max(GAP_FACTOR * gap, self.tolerance / 3)
            master, peaks = self._joined(master, current, found, gap)
        best, largest = self._settled(candidates, peaks)
        return ColumnGenerationResult(best.dual, largest, measure, tuple(rounds))

    def _verified(
        self, candidates: list[CandidateDual], found: LocalMaxima, peaks: LocalMaxima, goal: float
    ) -> LocalMaxima:
        """Searches the largest F of the best candidate while its bound is below the goal: from a part of the starts,
        then from all. A part may refute it, and then another one is the best.

        The local maxima are joined to `found`.
        """
        while (best := _best(candidates)).upper < goal and best.starts < self.starts:
            part = self.starts // PRELIMINARY_PART
            largest = self._maximised(candidates, best, peaks, part if best.starts < part else self.starts)
            found = found.joined(largest.peaks)
        return found

    def _maximised(
        self, candidates: list[CandidateDual], candidate: CandidateDual, peaks: LocalMaxima, count: int
    ) -> DualMaximum:
        """Searches a candidate's largest F from `count` starts, and replaces the candidate by the rescaled one."""
        largest = maximise_dual_function(
            self.function, candidate.dual, peaks.points, self.rng, count=count, executor=self.executor
        )
        value = max(largest.value, self.function.size)
        candidates[candidates.index(candidate)] = CandidateDual.of(candidate.dual, value, largest)
        return largest

    def _settled(self, candidates: list[CandidateDual], peaks: LocalMaxima) -> tuple[CandidateDual, DualMaximum]:
        """The best candidate after the search of its largest F from all starts."""
        self._verified(candidates, peaks, peaks, np.inf)
        best = _best(candidates)
        if best.largest is None:
            raise RuntimeError("the largest F of the best candidate was not searched")
        return best, best.largest

    def _first(self) -> tuple[RestrictedMaster, LocalMaxima]:
        """Random states, and a diagonal D that is feasible for them."""
        viable = self.function.viable
        points = random_points(viable.joints, FIRST_STATES_PER_DIMENSION * 2 * viable.joints, self.rng)
        ddq = viable.vertices[self.rng.integers(len(viable.vertices), size=len(points))]
        gram, rates = self.function.moments(self.function.states(points, ddq))
        coordinates = DualCoordinates.of(gram, rates, self.symmetries)
        master = RestrictedMaster(coordinates, np.zeros((0, len(coordinates.start()))), coordinates.start())
        rows = coordinates.rows(gram, rates)
        return master.joined(rows, np.zeros(0, dtype=np.intp)), LocalMaxima(points, ddq, rows @ coordinates.start())

    def _measure(self, master: RestrictedMaster, peaks: LocalMaxima, gap: float) -> DesignMeasure:
        weights = master.weights(gap / len(peaks))
        value = master.coordinates.dual(master.z).value
        return DesignMeasure(peaks, weights, value - self.function.size * log(float(weights.sum())))

    def _priced(self, dual: DualVariables, current: DesignMeasure) -> LocalMaxima:
        """The pricing problem: local maxima of F from random starts and from the support."""
        best = current.peaks.points[np.argsort(-current.weights)[:SUPPORT_STARTS]]
        n = self.function.joints
        points = np.vstack([random_points(n, RANDOM_STARTS_PER_DIMENSION * 2 * n, self.rng), best])
        return local_maxima(
            self.function,
            dual,
            points,
            keep=ASCENTS_PER_DIMENSION * 2 * n,
            rule=BRIEF_ASCENT,
            executor=self.executor,
        )

    def _round(self, number: int, current: DesignMeasure, upper: float, best: float) -> GenerationRound:
        """The round, reported to `progress`."""
        this = GenerationRound(number, current.lower, upper, best, len(current.peaks))
        if self.progress is not None:
            self.progress(this)
        return this

    def _joined(
        self, master: RestrictedMaster, current: DesignMeasure, found: LocalMaxima, gap: float
    ) -> tuple[RestrictedMaster, LocalMaxima]:
        """The master and its states, with the distinct ones found whose constraints are nearly active or violated."""
        violating = found.value >= min(self.function.size - JOINING_MARGIN * gap, found.value.max())
        new = found.chosen(violating)
        _, distinct = np.unique(np.hstack([new.points.round(STATE_DECIMALS), new.ddq]), axis=0, return_index=True)
        new = new.chosen(distinct)
        retained = np.argsort(-current.weights)[:MOST_STATES]
        rows = master.coordinates.rows(*self.function.moments(self.function.states(new.points, new.ddq)))
        return master.joined(rows, retained), current.peaks.chosen(retained).joined(new)


def _best(candidates: list[CandidateDual]) -> CandidateDual:
    return min(candidates, key=attrgetter("upper"))
