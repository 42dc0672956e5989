"""Optimise: from a start to a motion within its limits at every instant, and from many starts to the best of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from design.limit_use import LimitUse
from design.motion.fourier import FreeSeries
from design.motion.series import Motion
from design.optimiser.objective import Objective
from design.optimiser.program import Outcome, program
from design.optimiser.rows import Rows
from design.random_feasible import random_feasible
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.rig import Limits, Workspace

Array = NDArray[np.float64]

LOSS = 0.01
"""Nats that contracting a motion into its limits may cost, before the limits are asked for at more instants."""
HARMLESS = 0.05
"""Nats that it may have cost in the end for the motion to count as the optimum: a hundredth of the samples."""
ROUNDS = 5
"""How often instants are added; two or three are the rule."""
SLOW = (1, 2, 3, 4)
"""Harmonics of random starts: large motions. Noise of the highest frequencies leads to small optima (measured: half a
nat less), and six harmonics take ten times as long as four to an optimum of the same height."""
INSIDE = 0.9
"""Random starts use nine tenths of their limits, so that the interior point starts inside."""
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

    def towards_rest(self, motion: Motion, factor: float) -> Motion:
        """The motion contracted to a share `factor` of it about standing still at its mean posture."""
        series = motion.series
        still = series.rest(motion.derivative(series.instants(self.objective.samples), 0).mean(axis=0))
        return replace(motion, coefficients=still + factor * (motion.coefficients - still))


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


def improve(task: Task, start: Motion) -> Attempt:
    """The local optimum that a start leads to.

    Limits are asked for at a few instants first, then also at many where the solution comes near them, until
    contracting it into them costs less than `LOSS`. The best motion of all rounds is taken, the contracted start among
    them. Raises InputError when nothing feasible is near.
    """
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
    if best is None:
        remedy = "widen them, or give a series with more freedom (an offset, more harmonics)"
        raise InputError(what="no motion within the limits was found", where="limits", remedy=remedy)
    return replace(best, evaluations=evaluations, seconds=perf_counter() - began)


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
    use = task.use(motion).worst.use
    if use <= 1:
        return motion
    if task.use(task.towards_rest(motion, 0.0)).worst.use > 1:
        return None
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
    executor: Executor | None = None,
    progress: Callable[[Attempt], None] | None = None,
) -> tuple[Attempt, ...]:
    """The local optima that starts lead to, best first.

    `executor` (`concurrent.futures.Executor` or its like) works on the starts elsewhere; `progress` is told of each as
    it comes. In threads they take turns, because the linear solver does not share: take processes. Raises InputError
    when no start leads to a motion within the limits.
    """
    attempts, refused = list[Attempt](), list[InputError]()
    for tried in _attempts(task, list(starts), executor):
        if isinstance(tried, InputError):
            refused.append(tried)
            continue
        attempts.append(tried)
        if progress is not None:
            progress(tried)
    if refused and not attempts:
        raise refused[0]
    return tuple(sorted(attempts, key=lambda attempt: -attempt.value))


def _attempts(task: Task, starts: list[Motion], executor: Executor | None) -> Iterator[Attempt | InputError]:
    if executor is None:
        yield from (_tried(task, start) for start in starts)
        return
    futures = [executor.submit(_tried, task, start) for start in starts]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


def _tried(task: Task, start: Motion) -> Attempt | InputError:
    """One start that leads nowhere does not take the others with it."""
    try:
        return improve(task, start)
    except InputError as error:
        return error
