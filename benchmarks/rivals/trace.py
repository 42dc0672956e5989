"""Trace: the best feasible motion that a run had by when. Recorder: an objective that writes one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
import numpy.typing as npt

from benchmarks.rivals.objective import Objective, Score
from benchmarks.rivals.reference import LIMITS
from design.limits import LimitUse
from design.trajectories.trajectory import Trajectory

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-3
"""A rival's motion counts as feasible when its samples keep the limits to this, which is what is asked of ours at every
instant; what the rivals break between the samples is shown and not held against them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """A run, or several one after the other: its improvements, what they took, and the last of them.

    seconds of processor time, evaluations and logdet (m,) of each improvement, all rising; motion is that of the last,
    None if there is no feasible one; total_seconds and total_evaluations until the run ended.
    """

    name: str
    seconds: Array
    evaluations: Array
    logdet: Array
    motion: Trajectory | None
    total_seconds: float
    total_evaluations: int

    @property
    def best(self) -> float:
        """The largest ln det, minus infinity when there is none."""
        return float(self.logdet[-1]) if len(self.logdet) else -np.inf

    @property
    def use(self) -> float:
        """The largest use of a limit at every instant, of the last motion."""
        return np.nan if self.motion is None else LimitUse.of(self.motion, LIMITS).worst.use

    def first_better(self, level: float) -> float:
        """Seconds until a motion was better than `level`; infinity when none was."""
        better = np.flatnonzero(self.logdet > level)
        return float(self.seconds[better[0]]) if len(better) else np.inf

    def followed_by(self, other: Trace) -> Trace:
        """Both, one after the other: only what is better than before counts."""
        better = other.logdet > self.best
        return replace(
            self,
            seconds=np.append(self.seconds, self.total_seconds + other.seconds[better]),
            evaluations=np.append(self.evaluations, self.total_evaluations + other.evaluations[better]),
            logdet=np.append(self.logdet, other.logdet[better]),
            motion=other.motion if better.any() else self.motion,
            total_seconds=self.total_seconds + other.total_seconds,
            total_evaluations=self.total_evaluations + other.total_evaluations,
        )


class OutOfTimeError(Exception):
    """The processor time that a run was given is used."""


class Recorder:
    """An objective whose evaluations are counted and whose improvements are noted; its clock starts when it is made.

    It raises `OutOfTimeError` when an evaluation is asked for after so many `seconds` of processor time.
    """

    def __init__(self, objective: Objective, name: str, seconds: float = np.inf) -> None:
        objective.score(np.zeros((1, objective.series.size)))  # deriving and the basis are made before the clock starts
        self.objective, self.name, self.seconds = objective, name, seconds
        self.evaluations, self.best = 0, -np.inf
        self.notes: list[tuple[float, int, float]] = []
        self.improvements: list[Array] = []
        self.began = process_time()

    def costs(self, x: Array) -> Array:
        """Costs (B,) of scaled coefficients (B, k)."""
        return self.noted(x).cost

    def cost(self, x: Array) -> float:
        """The cost of scaled coefficients (k,)."""
        return float(self.noted(np.asarray(x)[None]).cost[0])

    def noted(self, x: Array) -> Score:
        """The score of scaled coefficients (B, k), the best of them noted when it is feasible and an improvement."""
        if process_time() - self.began > self.seconds:
            raise OutOfTimeError
        score = self.objective.score(x)
        self.evaluations += len(x)
        best = int(np.argmax(np.where(score.use <= 1 + TOLERANCE, score.logdet, -np.inf)))
        if score.use[best] <= 1 + TOLERANCE and score.logdet[best] > self.best:
            self.best = float(score.logdet[best])
            self.improvements.append(x[best].copy())
            self.notes.append((process_time() - self.began, self.evaluations, self.best))
        return score

    def trace(self) -> Trace:
        """What was noted until now."""
        total = process_time() - self.began
        notes = np.array(self.notes, dtype=float).reshape(-1, 3)
        return Trace(
            name=self.name,
            seconds=notes[:, 0],
            evaluations=notes[:, 1],
            logdet=notes[:, 2],
            motion=self.objective.motion(self.improvements[-1]) if self.improvements else None,
            total_seconds=total,
            total_evaluations=self.evaluations,
        )


def one_after_the_other(traces: Sequence[Trace]) -> Trace:
    """Several runs in one trace."""
    whole = traces[0]
    for trace in traces[1:]:
        whole = whole.followed_by(trace)
    return whole
