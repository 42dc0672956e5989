"""Column generation: states joined to the restricted master until the optimality gap closes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from math import log
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from design.bound.dual_function import DualFunction, DualVariables, Symmetry
from design.bound.multistart_ascent import (
    DualMaximum,
    LocalMaxima,
    StoppingRule,
    local_maxima,
    maximise_dual_function,
    random_points,
)
from modeling.errors import InputError

Array = NDArray[np.float64]

CENTRAL_DECREMENT = 1e-2
"""Squared Newton decrement, in units of the barrier, of a central point: Newton's method converges below 1/4."""
CENTRING_STEPS = 60
"""Most Newton steps of a centring; about 10 are typical."""
CENTRING_FRACTION_TO_BOUNDARY = 0.98
"""Fraction to the boundary: share of the way to the nearest constraint that a step may go."""
ARMIJO_SHARE = 1e-4
"""Armijo's share of the predicted decrease: any small one will do."""
SHORTEST_STEP = 1e-10
"""A step as short as this no longer changes the point."""
RIDGE = 1e-12
"""Added to the scaled Newton matrix, where conditions are linearly dependent over the current states."""


@dataclass(frozen=True, eq=False)
class DualCoordinates:
    """z: the entries of D that are not zero by symmetry, then c, each scaled to about one.

    scale    (k,) of the parameters: rms of their columns
    rates    (K,) of the conditions: rms of L h
    entries  the free pairs i <= j of D
    """

    scale: Array
    rates: Array
    entries: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, gram: Array, rates: Array, symmetries: tuple[Symmetry, ...]) -> DualCoordinates:
        """From Phi'Phi (N, k, k) and L h (N, K) of states distributed over the viable set.

        Raises InputError when a parameter has no information in any state.
        """
        scale = np.sqrt(np.einsum("nii->i", gram) / len(gram))
        if not (scale > 0).all():
            what = "a parameter has no information in any state, and ln det is minus infinity for every trajectory"
            raise InputError(what=what, where="bound", remedy="leave the effect with that parameter out")
        k = len(scale)
        free = [(i, j) for i in range(k) for j in range(i, k) if _free(symmetries, i, j)]
        size = np.sqrt((rates**2).mean(axis=0))
        return cls(scale=scale, rates=np.where(size > 0, size, 1.0), entries=tuple(free))

    @cached_property
    def directions(self) -> Array:
        """E (m, k, k) with D = sum_i z_i E_i, scaled."""
        k = len(self.scale)
        out = np.zeros((len(self.entries), k, k))
        for place, (i, j) in enumerate(self.entries):
            out[place, i, j] = out[place, j, i] = 1 / (self.scale[i] * self.scale[j])
        return out

    def rows(self, gram: Array, rates: Array) -> Array:
        """J (N, m + K) with F = J z."""
        return np.hstack([np.einsum("nij,mij->nm", gram, self.directions, optimize=True), rates / self.rates])

    def start(self) -> Array:
        """z of D diagonal, c = 0."""
        diagonal = np.array([float(i == j) for i, j in self.entries])
        return np.concatenate([diagonal, np.zeros(len(self.rates))])

    def matrix(self, z: Array) -> Array:
        """D (k, k)."""
        return np.asarray(np.tensordot(z[: len(self.entries)], self.directions, axes=1))

    def dual(self, z: Array) -> DualVariables:
        """D and c."""
        return DualVariables(self.matrix(z), z[len(self.entries) :] / self.rates)


def _free(symmetries: tuple[Symmetry, ...], i: int, j: int) -> bool:
    return all(s.signs[i] * s.signs[j] > 0 for s in symmetries)


@dataclass(frozen=True, eq=False)
class RestrictedMaster:
    """minimise -ln det D over (D, c) with F(x_i) <= k at N states: rows J (N, m + K) of F = J z, and a feasible z.

    The barrier problem is: minimise -ln det D - mu sum_i ln(k - F_i). At its minimum the weights w_i = mu/(k - F_i)
    are a measure with sum w_i Phi_i'Phi_i = D^-1 and sum w_i (L h)_i = 0, and because F is linear in (D, c),
    k = sum w_i F_i = k sum w_i - N mu. So w / sum w is a measure that meets all conditions with
    ln det M = -ln det D - k ln(1 + N mu/k): a primal value, a lower bound of the dual optimum by N mu.
    """

    coordinates: DualCoordinates
    rows: Array
    z: Array

    @property
    def size(self) -> int:
        """The number of parameters k."""
        return len(self.coordinates.scale)

    @cached_property
    def slack(self) -> Array:
        """k - F_i (N,)."""
        return np.asarray(self.size - self.rows @ self.z)

    def centred(self, mu: float) -> RestrictedMaster:
        """At the minimum of the barrier problem, by Newton's method from z."""
        master = self
        for _ in range(CENTRING_STEPS):
            gradient, matrix = master._newton(mu)
            scale = 1 / np.sqrt(np.diag(matrix))
            scaled = matrix * scale * scale[:, None] + RIDGE * np.eye(len(scale))
            step = -scale * cho_solve(cho_factor(scaled), scale * gradient)
            decrement = -float(gradient @ step)
            master = master._line_search(step, decrement, mu)
            if decrement < CENTRAL_DECREMENT * mu:
                break
        return master

    def weights(self, mu: float) -> Array:
        """w_i (N,) at the minimum of the barrier problem."""
        return np.asarray(mu / self.slack)

    def joined(self, rows: Array, retained: NDArray[np.intp]) -> RestrictedMaster:
        """With more states, and the `retained` of its own; z is scaled so that it is feasible again."""
        joined = np.vstack([self.rows[retained], rows])
        largest = float((joined @ self.z).max())
        factor = min(1.0, CENTRING_FRACTION_TO_BOUNDARY * self.size / largest)
        return replace(self, rows=joined, z=self.z * factor)

    def _newton(self, mu: float) -> tuple[Array, Array]:
        """Gradient and Hessian of the barrier problem."""
        m, directions = len(self.coordinates.entries), self.coordinates.directions
        solved = np.linalg.solve(self.coordinates.matrix(self.z), directions)
        weights = mu / self.slack
        gradient = self.rows.T @ weights
        gradient[:m] -= np.einsum("mii->m", solved)
        weighted = self.rows * (weights / np.sqrt(mu))[:, None]
        matrix = weighted.T @ weighted
        matrix[:m, :m] += np.einsum("aij,bji->ab", solved, solved)
        return gradient, matrix

    def _barrier(self, mu: float, z: Array, slack: Array) -> float:
        D = self.coordinates.matrix(z)
        if slack.min() <= 0 or np.linalg.eigvalsh(D)[0] <= 0:
            return np.inf
        return float(-np.linalg.slogdet(D)[1] - mu * np.log(slack).sum())

    def _line_search(self, step: Array, decrement: float, mu: float) -> RestrictedMaster:
        """The longest of t, t/2, t/4 .. of the step that is feasible, with Armijo decrease."""
        change, before = self.rows @ step, self._barrier(mu, self.z, self.slack)
        shrinking = np.maximum(change, 0) / self.slack
        length = min(1.0, CENTRING_FRACTION_TO_BOUNDARY / max(float(shrinking.max()), 1e-300))
        while length > SHORTEST_STEP:
            z = self.z + length * step
            if self._barrier(mu, z, self.slack - length * change) <= before - ARMIJO_SHARE * length * decrement:
                return replace(self, z=z)
            length /= 2
        return self


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
    def of(cls, dual: DualVariables, value: float, largest: DualMaximum | None = None) -> CandidateDual:
        """The dual scaled so that the largest F, `value`, becomes k: then -ln det D is the bound."""
        scaled = dual.scaled(len(dual.D) / value)
        return cls(scaled, scaled.value, largest)

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
ASCENTS_PER_DIMENSION = 200
"""Ascents of a search for each dimension: many at once take little time and save rounds."""
BRIEF_ASCENT = StoppingRule(steps=25, gain_tolerance=1e-5)
"""Of these ascents: a cut need not be the deepest; `maximise_dual_function` is more thorough."""
FIRST_GAP = 1.0
"""The first gap between the barrier's two bounds, in ln det: about the distance of random states from the optimum."""
GAP_FACTOR = 0.4
"""Factor of the gap when the search finds little: a smaller one needs fewer rounds, each with more steps."""
STALL_GAPS = 1.5
"""The search has stalled when the round's bounds differ by less than this many gaps: one gap is the barrier's own."""
JOINING_MARGIN = 0.3
"""States are joined if F is above k minus this share of the gap: the next active constraints."""
PRELIMINARY_PART = 4
"""Divisor of the starts of a candidate's few search: it refutes most of those that the full one refutes."""
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
            maxima = self._priced(dual, current)
            candidates.append(CandidateDual.of(dual, float(maxima.value.max())))
            upper, measure = candidates[-1].upper, max(measure, current, key=attrgetter("lower"))
            maxima = self._verified(candidates, maxima, peaks, measure.lower + self.tolerance)
            rounds.append(self._round(number, current, upper, _best(candidates).upper))
            if _best(candidates).upper < measure.lower + self.tolerance:
                break
            if upper - current.lower < STALL_GAPS * gap:
                gap = max(GAP_FACTOR * gap, self.tolerance / 3)
            master, peaks = self._joined(master, current, maxima, gap)
        best, largest = self._settled(candidates, peaks)
        return ColumnGenerationResult(best.dual, largest, measure, tuple(rounds))

    def _verified(
        self, candidates: list[CandidateDual], maxima: LocalMaxima, peaks: LocalMaxima, goal: float
    ) -> LocalMaxima:
        """Searches the largest F of the best candidate while its bound is below the goal: from a part of the starts,
        then from all. A part may refute it, and then another one is the best.

        Returns `maxima` with these local maxima joined.
        """
        while (best := _best(candidates)).upper < goal and best.starts < self.starts:
            few = self.starts // PRELIMINARY_PART
            largest = self._maximised(candidates, best, peaks, few if best.starts < few else self.starts)
            maxima = maxima.joined(largest.peaks)
        return maxima

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
        self, master: RestrictedMaster, current: DesignMeasure, maxima: LocalMaxima, gap: float
    ) -> tuple[RestrictedMaster, LocalMaxima]:
        """The master and its states, with the distinct ones found whose constraints are nearly active or violated."""
        violating = maxima.value >= min(self.function.size - JOINING_MARGIN * gap, maxima.value.max())
        new = maxima.chosen(violating)
        _, distinct = np.unique(np.hstack([new.points.round(STATE_DECIMALS), new.ddq]), axis=0, return_index=True)
        new = new.chosen(distinct)
        retained = np.argsort(-current.weights)[:MOST_STATES]
        rows = master.coordinates.rows(*self.function.moments(self.function.states(new.points, new.ddq)))
        return master.joined(rows, retained), current.peaks.chosen(retained).joined(new)


def _best(candidates: list[CandidateDual]) -> CandidateDual:
    return min(candidates, key=attrgetter("upper"))
