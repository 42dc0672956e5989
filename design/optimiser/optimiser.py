"""Optimise: from a start to a motion within its limits at every instant, and from many starts to the best of them."""

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

from design.limit_use import LimitUse, Reach
from design.motion.fourier import FreeSeries
from design.motion.series import Motion
from design.optimiser.expansion import Expansion
from design.optimiser.interior import Interior
from design.optimiser.objective import Objective
from design.optimiser.polytope import Polytope
from design.optimiser.program import Outcome, Solution, program
from design.optimiser.rows import Rows
from design.random_feasible import random_feasible
from design.workspace import workspace_sides
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.rig import Limits, Workspace

Array = NDArray[np.float64]

LOSS = 0.01
"""Nats that contracting a motion into its limits may cost, before the limits are asked for at more instants."""
HARMLESS = 0.05
"""Nats that it may have cost in the end for the motion to count as the optimum: a hundredth of the samples."""
LITTLE = 2e-3
"""Nats: a round that gains no more is the last."""
ROUNDS = 5
"""How often instants are added; two or three are the rule."""
SLOW = (1, 2, 3, 4)
"""Harmonics of random starts: large motions. Noise of the highest frequencies leads to small optima (measured: half a
nat less), and six harmonics take ten times as long as four to an optimum of the same height."""
INSIDE, MIDDLING = 0.9, 0.5
"""Random starts use nine tenths of their limits, so that the interior point starts inside; half where it is to be as
free to grow as to shrink (measured: more of them lead to the highest optima)."""
PULL = 3.0, 0.3, 0.1
"""The barrier of an interior point is PULL nats in all to begin with: from afar, next to an optimum with other rows,
and on it. From afar 10 draw most starts to one optimum, and with 1 they take twice as long."""
LAST = 1e-3, 1e-4, 1e-5
"""The last barrier parameter, nats: from afar, to rank optima, and to tell them. Between the first two the motion is
contracted a little, which leads away from saddles and narrow optima (measured: a third gain up to 0.2 nats)."""
ROOM = 0.05, 0.02, 1e-3
"""The share of the room of standing still that a start leaves at least, for the same three cases."""
FEWEST, OVERSAMPLED = 48, 4
"""Samples that stand for more in a search: four to each function of the series give the mean over time to 1e-6."""
HALVINGS = 20
CLOSE = 1e-7
"""A contraction is found to this share: what it costs is far below the optimiser's accuracy."""
ROUNDED = 1 - 1e-9
"""A motion is kept away from its limits by this, so that rounding does not carry it beyond."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """What is to be optimised, within which limits."""

    objective: Objective
    limits: Limits
    arm: Arm | None = None
    workspace: Workspace | None = None
    tip_length: float | None = None
    iterations: int = 500

    def use(self, motion: Motion) -> LimitUse:
        """How much of the limits a motion uses, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def random(self, seed: Sequence[int]) -> Motion:
        """A random motion of few harmonics that uses nine tenths of its limits, as near as the series comes to it."""
        series = self.objective.series
        found = random_feasible(
            FreeSeries(joints=series.joints, harmonics=SLOW, period=series.duration),
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )
        return self.towards_rest(found.projected(series), INSIDE)

    def varied(self, seed: Sequence[int], *, odd: bool) -> Motion:
        """A random motion that uses half its limits; odd in time about its mean posture where that is asked for.

        Reversing time and mirroring the arm together leave the information of many arms as it is, so that optima
        among the odd motions are optima among all, and they are found more often there (measured: five times).
        """
        motion = self.random(seed)
        return self.towards_rest(motion.odd() if odd else motion, MIDDLING)

    def towards_rest(self, motion: Motion, factor: float) -> Motion:
        """The motion contracted to a share `factor` of it about standing still at its mean posture."""
        still = self.still(motion)
        return replace(motion, coefficients=still + factor * (motion.coefficients - still))

    def still(self, motion: Motion) -> Array:
        """Coefficients (k,) of standing still at the motion's mean posture."""
        series = motion.series
        return series.rest(motion.derivative(series.instants(self.objective.samples), 0).mean(axis=0))

    @property
    def direct(self) -> bool:
        """Whether the derivatives are exact and all limits linear: then the own interior point does it."""
        return self.objective.exact and (self.workspace is None or not workspace_sides(self.workspace, self.arm))

    @cached_property
    def expansion(self) -> Expansion:
        """The objective in numbers, over all samples."""
        return Expansion(self.objective)

    @cached_property
    def thinned(self) -> Expansion:
        """The same over as few samples as stand for all of them."""
        enough = max(FEWEST, OVERSAMPLED * self.objective.series.mixing.shape[1])
        return self.expansion if enough >= self.objective.samples else Expansion(self.objective.thinned(enough))

    @cached_property
    def polytope(self) -> Polytope:
        """The joints' limits at enough instants to rank optima by."""
        return Polytope(Rows.medium(self.objective.series, self.limits))

    def __getstate__(self) -> dict[str, Any]:
        # What was compiled stays behind: it does not travel between processes, and is soon made again.
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, eq=False, kw_only=True)
class Attempt:
    """What one start came to: a motion within its limits at every instant.

    value is the criterion's, `lost` what contracting the motion into its limits took from it, evaluations how often it
    was asked, seconds how long it took.
    """

    motion: Motion
    value: float
    lost: float
    outcome: Outcome
    evaluations: int
    seconds: float


Work = Callable[[Task, Motion], Attempt]
"""What is done with a start."""


def screen(task: Task, start: Motion) -> Attempt:
    """What a start leads to, to rank it by: a motion that keeps its limits at some instants, and its value to 1e-2.

    For tasks that are `direct`. Raises InputError when the series cannot stand still within the limits.
    """
    began, evaluations, motion = perf_counter(), 0, start
    for case, last in enumerate(LAST[:2]):
        solution = _solved(task, task.thinned, task.polytope, motion, case=case, last=last)
        motion, evaluations = Motion(start.series, solution.coefficients), evaluations + solution.evaluations
    return Attempt(
        motion=motion,
        value=task.objective.value(motion.coefficients),
        lost=0.0,
        outcome=solution.outcome,
        evaluations=evaluations,
        seconds=perf_counter() - began,
    )


def improve(task: Task, start: Motion) -> Attempt:
    """The local optimum that a start leads to.

    Limits are asked for at a few instants first, then also at many where the solution comes near them, until
    contracting it into them costs less than `LOSS`. The best motion of all rounds is taken, the contracted start among
    them. Raises InputError when nothing feasible is near.
    """
    if not task.direct:
        return _improved(task, start)
    screened = screen(task, start)
    polished = polish(task, screened.motion)
    return replace(polished, evaluations=polished.evaluations + screened.evaluations)


def polish(task: Task, start: Motion) -> Attempt:
    """The local optimum next to a motion that `screen` found, within its limits at every instant."""
    began, evaluations, best = perf_counter(), 1, _contracted(task, start, Outcome.FAILED)
    rows, motion = task.polytope.rows.refined(start.coefficients), start
    for round_ in range(ROUNDS):
        case = min(round_ + 1, len(PULL) - 1)
        solution = _solved(task, task.expansion, Polytope(rows), motion, case=case, last=LAST[2])
        evaluations += solution.evaluations
        motion = Motion(start.series, solution.coefficients)
        found = _contracted(task, motion, solution.outcome)
        before, best = best, max((a for a in (best, found) if a is not None), key=lambda a: a.value, default=None)
        settled = before is not None and best is not None and best.value - before.value < LITTLE
        if found is not None and (found.lost < LOSS or (round_ > 0 and settled)):
            break
        rows = rows.refined(solution.coefficients)
    return replace(_required(best), evaluations=evaluations, seconds=perf_counter() - began)


def _solved(task: Task, expansion: Expansion, polytope: Polytope, start: Motion, *, case: int, last: float) -> Solution:
    """The interior point from a start that is contracted until it is inside."""
    first = PULL[case] / (2 * len(polytope))
    for still in (task.still(start), task.objective.series.rest(task.limits.position.mean(axis=1))):
        share = polytope.reach(still, start.coefficients, ROOM[case])
        if share is not None:
            inside = still + share * (start.coefficients - still)
            return Interior(expansion, polytope).solve(
                inside, first=max(first, last), last=last, iterations=task.iterations
            )
    raise _nowhere()


def _improved(task: Task, start: Motion) -> Attempt:
    """The same by IPOPT, whatever the limits and the objective."""
    began = perf_counter()
    best = _contracted(task, start, Outcome.FAILED)
    rows = Rows.coarse(start.series, task.limits, arm=task.arm, workspace=task.workspace, tip_length=task.tip_length)
    coefficients, evaluations = start.coefficients, 1
    for round_ in range(ROUNDS):
        solution = program(task.objective, rows, coefficients).solve(iterations=task.iterations, warm=round_ > 0)
        coefficients, evaluations = solution.coefficients, evaluations + solution.evaluations
        if not np.isfinite(coefficients).all():
            break
        found = _contracted(task, Motion(start.series, coefficients), solution.outcome)
        best = max((a for a in (best, found) if a is not None), key=lambda a: a.value, default=None)
        if found is not None and found.lost < LOSS:
            break
        rows = rows.refined(coefficients)
    return replace(_required(best), evaluations=evaluations, seconds=perf_counter() - began)


def _required(best: Attempt | None) -> Attempt:
    if best is None:
        raise _nowhere()
    return best


def _nowhere() -> InputError:
    remedy = "widen them, or give a series with more freedom (an offset, more harmonics)"
    return InputError(what="no motion within the limits was found", where="limits", remedy=remedy)


def _contracted(task: Task, motion: Motion, outcome: Outcome) -> Attempt | None:
    """The motion contracted into its limits; None where that is not possible."""
    inside = within(task, motion)
    if inside is None:
        return None
    value = task.objective.value(inside.coefficients)
    lost = task.objective.value(motion.coefficients) - value if inside is not motion else 0.0
    held = outcome if outcome is not Outcome.CONVERGED or lost < HARMLESS else Outcome.CONTRACTED
    return Attempt(motion=inside, value=value, lost=lost, outcome=held, evaluations=0, seconds=0.0)


def within(task: Task, motion: Motion) -> Motion | None:
    """The motion contracted about standing still until it keeps all limits; None where even standing still does not."""
    if not np.isfinite(motion.coefficients).all():
        return None
    use = task.use(motion)
    if use.worst.use <= 1:
        return motion
    still = task.use(task.towards_rest(motion, 0.0))
    if still.worst.use > 1:
        return None
    shrunk = task.towards_rest(motion, _share(use.reaches, still.reaches))
    if task.direct and task.use(shrunk).worst.use <= 1:
        return shrunk
    return _halved(task, motion, use.worst.use)


def _share(reaches: Sequence[Reach], still: Sequence[Reach]) -> float:
    """The largest part of a motion about standing still that is within limits that are linear in it."""
    shares = [
        room / beyond
        for moving, rest in zip(reaches, still, strict=True)
        for beyond, room in (
            (moving.high - rest.high, moving.limit[1] - rest.high),
            (rest.low - moving.low, rest.low - moving.limit[0]),
        )
        if beyond > room
    ]
    return ROUNDED * min(shares, default=1.0)


def _halved(task: Task, motion: Motion, use: float) -> Motion:
    low, high = 0.0, 1.0
    for step in range(HALVINGS):
        middle = ROUNDED / use if step == 0 else (low + high) / 2
        inside = task.use(task.towards_rest(motion, middle)).worst.use <= 1
        low, high = (middle, high) if inside else (low, middle)
        if high - low < CLOSE:
            break
    return task.towards_rest(motion, low)


def optimise(
    task: Task,
    starts: Iterable[Motion],
    *,
    work: Work = improve,
    executor: Executor | None = None,
    progress: Callable[[Attempt], None] | None = None,
) -> tuple[Attempt, ...]:
    """What `work` makes of each start, best first; of equal ones that of the earlier start.

    `executor` (`concurrent.futures.Executor` or its like) works on the starts elsewhere, with the same results;
    `progress` is told of each as it comes. In threads they take turns where IPOPT is needed, because its linear solver
    does not share: take processes. Raises InputError when no start leads to a motion within the limits.
    """
    begin = list(starts)
    attempts, refused = dict[int, Attempt](), dict[int, InputError]()
    for place, tried in _attempts(task, begin, work, executor):
        if isinstance(tried, InputError):
            refused[place] = tried
            continue
        attempts[place] = tried
        if progress is not None:
            progress(tried)
    if refused and not attempts:
        raise refused[min(refused)]
    return tuple(sorted((attempts[place] for place in sorted(attempts)), key=lambda attempt: -attempt.value))


def _attempts(
    task: Task, starts: list[Motion], work: Work, executor: Executor | None
) -> Iterator[tuple[int, Attempt | InputError]]:
    """The place of each start and what came of it, as it comes."""
    if executor is None:
        yield from ((place, _tried(task, start, work)) for place, start in enumerate(starts))
        return
    packed = pickle.dumps(task)
    futures: dict[Future[Attempt | InputError], int] = {
        executor.submit(_elsewhere, packed, start, work): place for place, start in enumerate(starts)
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


def _elsewhere(packed: bytes, start: Motion, work: Work) -> Attempt | InputError:
    return _tried(_unpacked(packed), start, work)


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Task:
    """The task, once for all its starts that a process is given: what it compiles is made once."""
    task: Task = pickle.loads(packed)  # noqa: S301 (bytes of the process that submitted it)
    return task


def _tried(task: Task, start: Motion, work: Work) -> Attempt | InputError:
    """One start that leads nowhere does not take the others with it."""
    try:
        return work(task, start)
    except InputError as error:
        return error
