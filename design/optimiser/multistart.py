"""Local optimisation from one start, contraction into the limits, and multistart over many starts."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.limits.limit_use import LimitedQuantity, LimitUse
from design.limits.random_feasible import random_feasible_trajectory
from design.limits.tip_workspace import workspace_sides
from design.optimiser.interior_point import InteriorPoint
from design.optimiser.limit_constraints import LimitConstraints
from design.optimiser.nonlinear_program import OptimiserSolution, TerminationStatus, limit_constrained_program
from design.optimiser.objective import Objective
from design.optimiser.objective_derivatives import ObjectiveDerivatives
from design.optimiser.polytope import Polytope
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.rig.rig import Limits, Workspace

Array = NDArray[np.float64]

CONTRACTION_TOLERANCE = 0.01
"""Nats that contraction into the limits may cost before the limits are imposed at more instants."""
HARMLESS_CONTRACTION = 0.05
"""Nats that it may finally have cost for the trajectory to count as the optimum: a hundredth of the samples."""
NEGLIGIBLE_GAIN = 2e-3
"""Nats: a round with a smaller gain is the last."""
REFINEMENT_ROUNDS = 5
"""Most rounds of adding instants; two or three are typical."""
LOW_HARMONICS = (1, 2, 3, 4)
"""Harmonics of random starts: large motions. Starts with the highest frequencies lead to poor optima (measured: half a
nat less), and six harmonics take ten times as long as four to an optimum of the same value."""
START_LIMIT_USE, VARIED_LIMIT_USE = 0.9, 0.5
"""Random starts use nine tenths of their limits, so that the interior point starts inside; half where they are to be as
free to grow as to shrink (measured: more of them lead to the highest optima)."""
FIRST_BARRIER = 3.0, 0.3, 0.1
"""The initial barrier in nats, summed over all constraints: from a random start, near an optimum of other constraints,
and at it. From random starts 10 attracts most of them to one optimum, and with 1 they take twice as long."""
LAST_BARRIER = 1e-3, 1e-4, 1e-5
"""The last barrier parameter, nats: from a random start, to rank optima, and for the final value. Between the first two
the trajectory is contracted a little, which leads away from saddles and narrow optima (measured: a third gain up to
0.2 nats)."""
START_MARGIN = 0.05, 0.02, 1e-3
"""The least share of the static posture's slack that a start leaves, for the same three cases."""
FEWEST_SAMPLES, SAMPLES_PER_FUNCTION = 48, 4
"""Samples that replace more in a search: four to each basis function give the mean over time to 1e-6."""
CONTRACTION_BISECTIONS = 20
CONTRACTION_ACCURACY = 1e-7
"""Relative accuracy of a contraction: its error in the criterion is far below the optimiser's accuracy."""
ROUNDING_CONTRACTION = 1 - 1e-9
"""Factor by which a contracted trajectory stays inside its limits, so that rounding does not carry it beyond."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignTask:
    """Objective and limits of an optimisation."""

    objective: Objective
    limits: Limits
    arm: Arm | None = None
    workspace: Workspace | None = None
    tip_length: float | None = None
    iterations: int = 500

    def use(self, motion: Trajectory) -> LimitUse:
        """Use of the limits by a trajectory, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def random(self, seed: Sequence[int]) -> Trajectory:
        """A random trajectory of few harmonics that uses nine tenths of its limits, projected on the series."""
        series = self.objective.series
        found = random_feasible_trajectory(
            FreeSeries(joints=series.joints, harmonics=LOW_HARMONICS, period=series.duration),
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )
        return self.towards_rest(found.projected(series), START_LIMIT_USE)

    def varied(self, seed: Sequence[int], *, odd: bool) -> Trajectory:
        """A random trajectory that uses half its limits; odd in time about its mean posture with `odd`.

        The information of many arms is invariant under time reversal combined with mirroring, so that optima among
        the odd trajectories are optima among all, and they are found more often there (measured: five times).
        """
        motion = self.random(seed)
        return self.towards_rest(motion.odd() if odd else motion, VARIED_LIMIT_USE)

    def towards_rest(self, motion: Trajectory, factor: float) -> Trajectory:
        """The trajectory scaled by `factor` about its mean posture."""
        static = self.still(motion)
        return replace(motion, coefficients=static + factor * (motion.coefficients - static))

    def still(self, motion: Trajectory) -> Array:
        """Coefficients (k,) of the trajectory's mean posture, static."""
        series = motion.series
        return series.rest(motion.derivative(series.instants(self.objective.samples), 0).mean(axis=0))

    @property
    def direct(self) -> bool:
        """Whether derivatives are exact and all limits linear: then `InteriorPoint` is used, otherwise IPOPT."""
        return self.objective.exact and (self.workspace is None or not workspace_sides(self.workspace, self.arm))

    @cached_property
    def derivatives(self) -> ObjectiveDerivatives:
        """Numerical derivatives of the objective, over all samples."""
        return ObjectiveDerivatives(self.objective)

    @cached_property
    def thinned(self) -> ObjectiveDerivatives:
        """The same over as few samples as represent all of them."""
        enough = max(FEWEST_SAMPLES, SAMPLES_PER_FUNCTION * self.objective.series.mixing.shape[1])
        return (
            self.derivatives
            if enough >= self.objective.samples
            else ObjectiveDerivatives(self.objective.thinned(enough))
        )

    @cached_property
    def polytope(self) -> Polytope:
        """The joint limits at enough instants to rank optima."""
        return Polytope(LimitConstraints.medium(self.objective.series, self.limits))

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: they are soon compiled again.
        return {field.name: getattr(self, field.name) for field in fields(self)}


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


LocalSearch = Callable[[DesignTask, Trajectory], LocalOptimum]
"""A local optimisation from a start."""


def screen_start(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The approximate local optimum of a start, for ranking: within its limits at some instants, value to 1e-2.

    For tasks that are `direct`. Raises InputError when no static posture of the series is within the limits.
    """
    begun, evaluations, motion = perf_counter(), 0, start
    for case, last in enumerate(LAST_BARRIER[:2]):
        solution = _solved(task, task.thinned, task.polytope, motion, case=case, last=last)
        motion, evaluations = Trajectory(start.series, solution.coefficients), evaluations + solution.evaluations
    return LocalOptimum(
        motion=motion,
        value=task.objective.value(motion.coefficients),
        contraction_loss=0.0,
        outcome=solution.outcome,
        evaluations=evaluations,
        seconds=perf_counter() - begun,
    )


def local_optimum(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The local optimum that a start leads to.

    Limits are imposed at a few instants first, then also at many where the solution comes near them, until its
    contraction into them costs less than `CONTRACTION_TOLERANCE`. The result is the best trajectory of all rounds, the
    contracted start included. Raises InputError when none is feasible.
    """
    if not task.direct:
        return _improved(task, start)
    screened = screen_start(task, start)
    refined = refine_optimum(task, screened.motion)
    return replace(refined, evaluations=refined.evaluations + screened.evaluations)


def refine_optimum(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """The local optimum near a trajectory that `screen_start` found, within its limits at every instant."""
    begun, evaluations, best = perf_counter(), 1, _contracted(task, start, TerminationStatus.FAILED)
    rows, motion = task.polytope.rows.refined(start.coefficients), start
    for round_ in range(REFINEMENT_ROUNDS):
        case = min(round_ + 1, len(FIRST_BARRIER) - 1)
        solution = _solved(task, task.derivatives, Polytope(rows), motion, case=case, last=LAST_BARRIER[2])
        evaluations += solution.evaluations
        motion = Trajectory(start.series, solution.coefficients)
        found = _contracted(task, motion, solution.outcome)
        before, best = best, max((a for a in (best, found) if a is not None), key=lambda a: a.value, default=None)
        settled = before is not None and best is not None and best.value - before.value < NEGLIGIBLE_GAIN
        if found is not None and (found.contraction_loss < CONTRACTION_TOLERANCE or (round_ > 0 and settled)):
            break
        rows = rows.refined(solution.coefficients)
    return replace(_required(best), evaluations=evaluations, seconds=perf_counter() - begun)


def _solved(
    task: DesignTask,
    derivatives: ObjectiveDerivatives,
    polytope: Polytope,
    start: Trajectory,
    *,
    case: int,
    last: float,
) -> OptimiserSolution:
    """The interior-point solution from a start that is contracted until it is strictly feasible."""
    first = FIRST_BARRIER[case] / (2 * len(polytope))
    for static in (task.still(start), task.objective.series.rest(task.limits.position.mean(axis=1))):
        share = polytope.reach(static, start.coefficients, START_MARGIN[case])
        if share is not None:
            inside = static + share * (start.coefficients - static)
            return InteriorPoint(derivatives, polytope).solve(
                inside, first=max(first, last), last=last, iterations=task.iterations
            )
    raise _infeasible()


def _improved(task: DesignTask, start: Trajectory) -> LocalOptimum:
    """`local_optimum` by IPOPT, for any limits and objective."""
    begun = perf_counter()
    best = _contracted(task, start, TerminationStatus.FAILED)
    rows = LimitConstraints.coarse(
        start.series, task.limits, arm=task.arm, workspace=task.workspace, tip_length=task.tip_length
    )
    coefficients, evaluations = start.coefficients, 1
    for round_ in range(REFINEMENT_ROUNDS):
        solution = limit_constrained_program(task.objective, rows, coefficients).solve(
            iterations=task.iterations, warm=round_ > 0
        )
        coefficients, evaluations = solution.coefficients, evaluations + solution.evaluations
        if not np.isfinite(coefficients).all():
            break
        found = _contracted(task, Trajectory(start.series, coefficients), solution.outcome)
        best = max((a for a in (best, found) if a is not None), key=lambda a: a.value, default=None)
        if found is not None and found.contraction_loss < CONTRACTION_TOLERANCE:
            break
        rows = rows.refined(coefficients)
    return replace(_required(best), evaluations=evaluations, seconds=perf_counter() - begun)


def _required(best: LocalOptimum | None) -> LocalOptimum:
    if best is None:
        raise _infeasible()
    return best


def _infeasible() -> InputError:
    remedy = "widen them, or give a series with more freedom (an offset, more harmonics)"
    return InputError(what="no trajectory within the limits was found", where="limits", remedy=remedy)


def _contracted(task: DesignTask, motion: Trajectory, outcome: TerminationStatus) -> LocalOptimum | None:
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


def contracted_into_limits(task: DesignTask, motion: Trajectory) -> Trajectory | None:
    """The trajectory contracted about its mean posture until it keeps all limits; None where that posture does not."""
    if not np.isfinite(motion.coefficients).all():
        return None
    use = task.use(motion)
    if use.worst.use <= 1:
        return motion
    static = task.use(task.towards_rest(motion, 0.0))
    if static.worst.use > 1:
        return None
    contracted = task.towards_rest(motion, _linear_factor(use.limited_quantities, static.limited_quantities))
    if task.direct and task.use(contracted).worst.use <= 1:
        return contracted
    return _bisected(task, motion, use.worst.use)


def _linear_factor(moving: Sequence[LimitedQuantity], static: Sequence[LimitedQuantity]) -> float:
    """The largest contraction factor about the mean posture for limits that are linear in the trajectory."""
    factors = [
        slack / excursion
        for moved, posture in zip(moving, static, strict=True)
        for excursion, slack in (
            (moved.high - posture.high, moved.limit[1] - posture.high),
            (posture.low - moved.low, posture.low - moved.limit[0]),
        )
        if excursion > slack
    ]
    return ROUNDING_CONTRACTION * min(factors, default=1.0)


def _bisected(task: DesignTask, motion: Trajectory, use: float) -> Trajectory:
    """The contraction by bisection of its factor, for nonlinear limits."""
    low, high = 0.0, 1.0
    for step in range(CONTRACTION_BISECTIONS):
        middle = ROUNDING_CONTRACTION / use if step == 0 else (low + high) / 2
        inside = task.use(task.towards_rest(motion, middle)).worst.use <= 1
        low, high = (middle, high) if inside else (low, middle)
        if high - low < CONTRACTION_ACCURACY:
            break
    return task.towards_rest(motion, low)


def optimise(
    task: DesignTask,
    starts: Iterable[Trajectory],
    *,
    work: LocalSearch = local_optimum,
    executor: Executor | None = None,
    progress: Callable[[LocalOptimum], None] | None = None,
) -> tuple[LocalOptimum, ...]:
    """The result of `work` from each start, best first; equal ones in the order of their starts.

    `executor` (`concurrent.futures.Executor` or its like) runs the starts in parallel, with the same results;
    `progress` is called with each result. Threads take turns where IPOPT is needed, because its linear solver is not
    thread-safe: take processes. Raises InputError when no start leads to a trajectory within the limits.
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
    return tuple(sorted((local_optima[number] for number in sorted(local_optima)), key=lambda found: -found.value))


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
