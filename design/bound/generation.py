"""Generation: states joined to the master until no viable state is left in which F is much too large."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from design.bound.candidate import Candidate
from design.bound.dual_function import Dual, DualFunction
from design.bound.largest import Largest, largest
from design.bound.master import Coordinates, Master
from design.bound.measure import Measure
from design.bound.search import Patience, Peaks, search, starts
from design.bound.symmetry import Symmetry

Array = NDArray[np.float64]

AT_RANDOM = 800
"""For each dimension of (q, dq), new starts of a search: four to an ascent, as in `largest`."""
FIRST = 600
"""For each dimension, states of the first master: several to each condition."""
MOST_STATES = 20_000
"""Of the master; those of least weight are dropped beyond. Every round adds some hundreds. Light states are needed too:
with 7000 kept, F rose where some had been dropped, from 6 to 100 on one rig, and what came back drove out others."""
BEST = 500
"""States of largest weight from which a search starts as well: F is largest near to them."""
KEPT, BRIEF = 200, Patience(steps=25, still=1e-5)
"""Ascents of a search for each dimension, and their steps: a cut need not be the deepest; `largest` looks harder.
Many at once cost little, and save rounds."""
WIDE = 1.0
"""The first gap between the barrier's two bounds, in ln det: about as far as random states are from the answer."""
NARROWER = 0.4
"""By which the gap is multiplied when the search finds little: smaller needs fewer rounds, each with more steps."""
NEARLY_DRY = 1.5
"""The search runs dry when the round's bounds are apart by less than so many gaps: one gap is the barrier's own."""
NEAR = 0.3
"""States are joined if F is above k less this share of the gap, where the central F is: they would matter next."""
FIRST_PART = 4
"""The part of the starts that a candidate has to survive before all are spent on it: most that fall, fall here."""
RESOLUTION = 3
"""Decimals in the cube by which states are told apart."""


@dataclass(frozen=True)
class Round:
    """One round, ln det of one sample: reached by a measure, the bound of this round's dual, the best bound so far.

    `states` is how many the master has.
    """

    number: int
    lower: float
    upper: float
    best: float
    states: int


@dataclass(frozen=True, eq=False)
class Generated:
    """The best dual, the largest F looked for, the measure that comes nearest to it, and the rounds."""

    dual: Dual
    largest: Largest
    measure: Measure
    rounds: tuple[Round, ...]


Progress = Callable[[Round], None]


@dataclass(eq=False)
class Generation:
    """Rounds of: centre the master, search for large F, join what was found. For ln det M of one sample.

    Whatever dual comes out, -ln det D + k ln(max F / k) bounds ln det M if max F is the largest F of all viable
    states: (D, c) k / max F is feasible. Central duals, and a gap that narrows only as the search runs dry, keep the
    rounds few: extreme duals of too few states swing from one end to the other. A dual that seems good enough has its
    largest F looked for from many new starts (`largest`); what that finds is joined as well.
    """

    function: DualFunction
    symmetries: tuple[Symmetry, ...]
    rng: np.random.Generator
    tolerance: float
    starts: int
    executor: Executor | None = None
    progress: Progress | None = None

    def run(self, most: int) -> Generated:
        """At most so many rounds, or until the best bound is within the tolerance of what can be reached."""
        (master, peaks), gap = self._first(), WIDE
        measure = Measure(peaks, np.ones(len(peaks)), -np.inf)
        candidates, rounds = list[Candidate](), list[Round]()
        for number in range(1, most + 1):
            master = master.centred(gap / len(peaks))
            here, dual = self._measure(master, peaks, gap), master.coordinates.dual(master.z)
            found = self._found(dual, here)
            candidates.append(Candidate.of(dual, float(found.value.max())))
            upper, measure = candidates[-1].upper, max(measure, here, key=_lower)
            found = self._judged(candidates, found, peaks, measure.lower + self.tolerance)
            rounds.append(self._told(number, here, upper, _best(candidates).upper))
            if _best(candidates).upper < measure.lower + self.tolerance:
                break
            if upper - here.lower < NEARLY_DRY * gap:
                gap = max(NARROWER * gap, self.tolerance / 3)
            master, peaks = self._joined(master, here, found, gap)
        best, looked = self._settled(candidates, peaks)
        return Generated(best.dual, looked, measure, tuple(rounds))

    def _judged(self, candidates: list[Candidate], found: Peaks, peaks: Peaks, goal: float) -> Peaks:
        """Looks for the largest F of the best candidate as long as it is below the goal: by a part of the starts, then
        by all. A part may be enough to refute it, and then another one is the best.

        What was found is joined to `found`.
        """
        while (best := _best(candidates)).upper < goal and best.starts < self.starts:
            part = self.starts // FIRST_PART
            looked = self._looked(candidates, best, peaks, part if best.starts < part else self.starts)
            found = found.joined(looked.peaks)
        return found

    def _looked(self, candidates: list[Candidate], candidate: Candidate, peaks: Peaks, count: int) -> Largest:
        """Replaces a candidate by what is known of it when its largest F was looked for from so many starts."""
        looked = largest(self.function, candidate.dual, peaks.points, self.rng, count=count, executor=self.executor)
        value = max(looked.value, self.function.size)
        candidates[candidates.index(candidate)] = Candidate.of(candidate.dual, value, looked)
        return looked

    def _settled(self, candidates: list[Candidate], peaks: Peaks) -> tuple[Candidate, Largest]:
        """The best candidate, once its largest F was looked for from all starts."""
        self._judged(candidates, peaks, peaks, np.inf)
        best = _best(candidates)
        if best.largest is None:
            raise RuntimeError("the best candidate was not looked at")
        return best, best.largest

    def _first(self) -> tuple[Master, Peaks]:
        """Random states, and a diagonal D that is feasible for them."""
        viable = self.function.viable
        points = starts(viable.joints, FIRST * 2 * viable.joints, self.rng)
        ddq = viable.vertices[self.rng.integers(len(viable.vertices), size=len(points))]
        gram, rates = self.function.moments(self.function.states(points, ddq))
        coordinates = Coordinates.of(gram, rates, self.symmetries)
        master = Master(coordinates, np.zeros((0, len(coordinates.start()))), coordinates.start())
        rows = coordinates.rows(gram, rates)
        return master.joined(rows, np.zeros(0, dtype=np.intp)), Peaks(points, ddq, rows @ coordinates.start())

    def _measure(self, master: Master, peaks: Peaks, gap: float) -> Measure:
        weights = master.weights(gap / len(peaks))
        value = master.coordinates.dual(master.z).value
        return Measure(peaks, weights, value - self.function.size * log(float(weights.sum())))

    def _found(self, dual: Dual, here: Measure) -> Peaks:
        best = here.peaks.points[np.argsort(-here.weights)[:BEST]]
        n = self.function.joints
        points = np.vstack([starts(n, AT_RANDOM * 2 * n, self.rng), best])
        return search(self.function, dual, points, keep=KEPT * 2 * n, patience=BRIEF, executor=self.executor)

    def _told(self, number: int, here: Measure, upper: float, best: float) -> Round:
        this = Round(number, here.lower, upper, best, len(here.peaks))
        if self.progress is not None:
            self.progress(this)
        return this

    def _joined(self, master: Master, here: Measure, found: Peaks, gap: float) -> tuple[Master, Peaks]:
        """The master and its states, with those found that matter and are not the same."""
        matter = found.value >= min(self.function.size - NEAR * gap, found.value.max())
        new = found.chosen(matter)
        _, single = np.unique(np.hstack([new.points.round(RESOLUTION), new.ddq]), axis=0, return_index=True)
        new = new.chosen(single)
        kept = np.argsort(-here.weights)[:MOST_STATES]
        rows = master.coordinates.rows(*self.function.moments(self.function.states(new.points, new.ddq)))
        return master.joined(rows, kept), here.peaks.chosen(kept).joined(new)


def _best(candidates: list[Candidate]) -> Candidate:
    return min(candidates, key=_upper)


def _upper(candidate: Candidate) -> float:
    return candidate.upper


def _lower(measure: Measure) -> float:
    return measure.lower
