"""Local optimum that one start leads to, by the interior-point method."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from design.optimiser.design_task import DesignTask, contracted_into_limits
from design.optimiser.interior_point import InteriorPoint, OptimiserSolution, TerminationStatus
from design.optimiser.limit_constraints import LimitConstraints, LimitRows
from design.optimiser.objective import ObjectiveDerivatives
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError

Array = NDArray[np.float64]

CONTRACTION_TOLERANCE = 0.01
"""Nats that contraction into the limits may cost before the limits are imposed at more instants."""
HARMLESS_CONTRACTION = 0.05
"""Nats that it may finally have cost for the trajectory to count as the optimum: a hundredth of the samples."""
NEGLIGIBLE_GAIN = 2e-3
"""Nats: a round with a smaller gain is the last."""
REFINEMENT_ROUNDS = 5
"""Most rounds of adding instants; two or three are typical."""
ROUGH_BARRIER = 1e-3
"""The last barrier parameter, nats, of a solution from a random start. The trajectory is then contracted a little,
which leads away from saddles and narrow optima (measured: a third gain up to 0.2 nats)."""
RANKING_BARRIER = 1e-4
"""The same of the solution that follows, by which optima are ranked."""
FINAL_BARRIER = 1e-5
"""The same for the final value, with exact second derivatives; without them the ranking's, which a tenth of the
iterations reach: some hundred limits that press leave a hundredth of a nat."""


@dataclass(frozen=True)
class StartQuality:
    """How the interior-point method begins, by what is expected of its start.

    barrier   initial barrier in nats, summed over all constraints
    margin    least share of the static posture's slack that the start leaves
    """

    barrier: float
    margin: float


RANDOM_START = StartQuality(barrier=3.0, margin=0.05)
"""A barrier of 10 attracts most random starts to one optimum, and with 1 they take twice as long."""
WIDE_START = StartQuality(barrier=300.0, margin=0.05)
"""A random start without exact second derivatives: of seven joints with five harmonics and clearances the mean of six
optima is 131.2 to 131.6, with 30 it is 131.0."""
CONTINUED = StartQuality(barrier=30.0, margin=0.02)
"""An optimum of few harmonics, to be continued with all: with 0.3 twice as many iterations, with 300 four times."""
NEAR_OPTIMUM = StartQuality(barrier=0.3, margin=0.02)
"""Near an optimum of other constraints."""
AT_OPTIMUM = StartQuality(barrier=0.1, margin=1e-3)
"""At the optimum but for the instants added."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LocalOptimum:
    """Result of one start: a trajectory within its limits at every instant.

    value is the criterion's, contraction_loss its loss by contraction into the limits, evaluations its number of
    evaluations, seconds the time taken.
    """

    motion: Trajectory
    value: float
    contraction_loss: float
    outcome: TerminationStatus
    evaluations: int
    seconds: float


def screen_start(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The approximate local optimum of a start, for ranking: within its limits at some instants, value to 1e-2.

    Raises InputError when no static posture of the series is within the limits.
    """
    if not task.second_order:
        return _screened(task, start, ((WIDE_START, RANKING_BARRIER),))
    return _screened(task, start, ((RANDOM_START, ROUGH_BARRIER), (NEAR_OPTIMUM, RANKING_BARRIER)))


def continue_start(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The same from an optimum of a series with fewer harmonics."""
    return _screened(task, start, ((CONTINUED, RANKING_BARRIER),))


def _screened(task: DesignTask, start: Trajectory, solutions: Sequence[tuple[StartQuality, float]]) -> LocalOptimum:
    """By solutions one after the other, each with what is expected of its start and its last barrier parameter."""
    begun, limits, motion, evaluations = perf_counter(), task.ranking_limits.rows, start, 0
    outcome = TerminationStatus.FAILED
    for quality, last in solutions:
        solution = _solved(task, task.thinned, limits, motion, quality, last=last)
        motion, outcome = Trajectory(start.series, solution.coefficients), solution.outcome
        evaluations += solution.evaluations
    return LocalOptimum(
        motion=motion,
        value=task.objective.value(motion.coefficients),
        contraction_loss=0.0,
        outcome=outcome,
        evaluations=evaluations,
        seconds=perf_counter() - begun,
    )


def local_optimum(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The local optimum that a start leads to.

    Limits are imposed at a few instants first, then also at many where the solution comes near them, until its
    contraction into them costs less than `CONTRACTION_TOLERANCE`. The result is the best trajectory of all rounds, the
    contracted start included. Raises InputError when none is feasible.
    """
    screened = screen_start(task, start)
    refined = refine_optimum(task, screened.motion)
    return replace(refined, evaluations=refined.evaluations + screened.evaluations)


def refine_optimum(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The local optimum near a trajectory that `screen_start` found, within its limits at every instant."""

    def solve(rows: LimitConstraints, motion: Trajectory, round_: int) -> OptimiserSolution:
        quality = NEAR_OPTIMUM if round_ == 0 else AT_OPTIMUM
        last = FINAL_BARRIER if task.second_order else RANKING_BARRIER
        return _solved(task, task.derivatives, rows.rows, motion, quality, last=last)

    return _refined(task, start, task.ranking_limits.refined(start.coefficients), solve, NEGLIGIBLE_GAIN)


def _solved(
    task: DesignTask,
    derivatives: ObjectiveDerivatives,
    limits: LimitRows,
    start: Trajectory,
    quality: StartQuality,
    *,
    last: float,
) -> OptimiserSolution:
    """The interior-point solution from a start that is contracted until it is strictly feasible."""
    first = quality.barrier / (2 * len(limits))
    insides = list[Array]()
    for static in (task.still(start), task.objective.series.rest(task.limits.position.mean(axis=1))):
        share = limits.reach(static, start.coefficients, quality.margin)
        if share is not None:
            insides.append(static + share * (start.coefficients - static))
    if not insides and limits.slack(start.coefficients).min() > 0:  # about a posture outside limits not linear
        insides.append(start.coefficients)
    if not insides:
        raise _infeasible(task, start)
    method = InteriorPoint(derivatives, limits, start.series.adjustable)
    return method.solve(insides[0], first=max(first, last), last=last, iterations=task.iterations)


RoundSolver = Callable[[LimitConstraints, Trajectory, int], OptimiserSolution]
"""The solution within limits at some instants, from a trajectory, in a round of refinement."""


def _refined(
    task: DesignTask, start: Trajectory, rows: LimitConstraints, solve: RoundSolver, least_gain: float
) -> LocalOptimum:
    """The best trajectory of rounds with limits at more and more instants, the contracted start included.

    The last round is one whose contraction costs less than `CONTRACTION_TOLERANCE`, or that gains less than
    `least_gain`.
    """
    begun, evaluations, motion = perf_counter(), 1, start
    best = given = contracted_optimum(task, start, TerminationStatus.FAILED)
    ended = TerminationStatus.FAILED
    for round_ in range(REFINEMENT_ROUNDS):
        solution = solve(rows, motion, round_)
        evaluations += solution.evaluations
        if not np.isfinite(solution.coefficients).all():
            break
        motion = Trajectory(start.series, solution.coefficients)
        contracted = contracted_optimum(task, motion, solution.outcome)
        ended = TerminationStatus.FAILED if contracted is None else contracted.outcome
        before, best = best, max((a for a in (best, contracted) if a is not None), key=lambda a: a.value, default=None)
        settled = before is not None and best is not None and best.value - before.value < least_gain
        if contracted is not None and (contracted.contraction_loss < CONTRACTION_TOLERANCE or (round_ > 0 and settled)):
            break
        rows = rows.refined(solution.coefficients)
    if best is None:
        raise _infeasible(task, start)
    outcome = ended if best is given else best.outcome  # nothing found was better than the start: why, is known
    return replace(best, outcome=outcome, evaluations=evaluations, seconds=perf_counter() - begun)


def _infeasible(task: DesignTask, start: Trajectory) -> InputError:
    """Names the limit that the start's mean posture uses most."""
    at = task.use(task.towards_rest(start, 0.0)).worst
    remedy = "widen them, or give a series with more freedom (an offset, more harmonics)"
    what = "no trajectory within the limits was found: the posture nearest to them "
    nearly = f"uses {at.use:.2%} of the {at.side} limit of the {at.quantity} of {at.name}, which leaves no room to move"
    what += f"is beyond {at.excess}" if at.use > 1 else nearly
    return InputError(what=what, where="limits", remedy=remedy)


def contracted_optimum(task: DesignTask, motion: Trajectory, outcome: TerminationStatus) -> LocalOptimum | None:
    """The trajectory contracted into its limits; None where that is not possible."""
    inside = contracted_into_limits(task, motion)
    if inside is None:
        return None
    value = task.objective.value(inside.coefficients)
    loss = task.objective.value(motion.coefficients) - value if inside is not motion else 0.0
    status = (
        outcome
        if outcome is not TerminationStatus.CONVERGED or loss < HARMLESS_CONTRACTION
        else TerminationStatus.CONTRACTED
    )
    return LocalOptimum(motion=inside, value=value, contraction_loss=loss, outcome=status, evaluations=0, seconds=0.0)


# Multistart: local optimisation from many starts, best first.


LocalSearch = Callable[[DesignTask, Trajectory], LocalOptimum]
"""A local optimisation from a start."""


def optimise(
    task: DesignTask,
    starts: Iterable[Trajectory],
    *,
    work: LocalSearch = local_optimum,
    executor: Executor | None = None,
    progress: Callable[[LocalOptimum], None] | None = None,
) -> tuple[LocalOptimum, ...]:
    """The result of `work` from each start, best first; equal ones in the order of their starts.

    `executor` (`concurrent.futures.Executor` or its like) runs several starts in parallel, with the same results;
    `progress` is called with each result. Raises InputError when no start leads to a trajectory within the limits.
    """
    local_optima, refused = dict[int, LocalOptimum](), dict[int, InputError]()
    for number, result in _results(task, list(starts), work, executor):
        if isinstance(result, InputError):
            refused[number] = result
            continue
        local_optima[number] = result
        if progress is not None:
            progress(result)
    if refused and not local_optima:
        raise refused[min(refused)]
    return tuple(sorted((local_optima[number] for number in sorted(local_optima)), key=lambda optimum: -optimum.value))


def _results(
    task: DesignTask, starts: list[Trajectory], work: LocalSearch, executor: Executor | None
) -> Iterator[tuple[int, LocalOptimum | InputError]]:
    """The number of each start and its result, in the order of completion."""
    if executor is None:
        yield from ((number, _result(task, start, work)) for number, start in enumerate(starts))
        return
    packed = pickle.dumps(task)
    futures: dict[Future[LocalOptimum | InputError], int] = {
        executor.submit(_result_in_worker, packed, start, work): number for number, start in enumerate(starts)
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


def _result_in_worker(packed: bytes, start: Trajectory, work: LocalSearch) -> LocalOptimum | InputError:
    return _result(_unpacked(packed), start, work)


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> DesignTask:
    """The task, unpickled once per process, so that its functions are compiled once."""
    task: DesignTask = pickle.loads(packed)  # noqa: S301 (bytes of the process that submitted it)
    return task


def _result(task: DesignTask, start: Trajectory, work: LocalSearch) -> LocalOptimum | InputError:
    """The result of one start; its error is returned, so that the other starts go on."""
    try:
        return work(task, start)
    except InputError as error:
        return error
