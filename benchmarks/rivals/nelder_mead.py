"""Nelder and Mead's simplex (Comput. J. 7 (1965) 308-313) by SciPy: with a penalty, and as the chapter used it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from benchmarks.rivals.objective import Objective
from benchmarks.rivals.reference import CHAPTER, LIMITS
from benchmarks.rivals.trace import Recorder, Trace
from design.limits import LimitUse
from design.trajectories.trajectory import Trajectory

Array = npt.NDArray[np.float64]

EVALUATIONS = 30_000
CHAPTER_EVALUATIONS = 115
"""Of the chapter's search, which ended at 22.17."""
CLOSE = 1e-4
"""A simplex is done when it is smaller than this in every coefficient and in ln det: SciPy's default."""
GAIN = 1e-3
"""What a new simplex at the end of the last one has to bring, or the next one starts elsewhere."""


def penalised(seed: int, evaluations: int = EVALUATIONS) -> Trace:
    """The 15 coefficients of 22.10 with the penalty, until all evaluations are used.

    With coefficients that adapt to the dimension (Gao and Han, Comput. Optim. Appl. 51 (2012) 259-277), and a fresh
    simplex where the last one ended, then at a new start: SciPy's defaults end after a tenth of the evaluations, at
    47 to 49.
    """
    recorder = Recorder(Objective(CHAPTER), "Nelder-Mead, penalty")
    restarted(recorder, seed, evaluations)
    return recorder.trace()


def restarted(recorder: Recorder, seed: int, evaluations: int) -> None:
    """The simplex on any recorder's objective."""
    objective = recorder.objective
    start, last, restarts = objective.start([seed, 0]), np.inf, 0
    while recorder.evaluations < evaluations:
        options: Any = {"maxfev": evaluations - recorder.evaluations, "adaptive": True, "xatol": CLOSE, "fatol": CLOSE}
        found = minimize(recorder.cost, start, method="Nelder-Mead", options=options)
        restarts += 1
        improved = last - found.fun > GAIN
        start, last = (found.x, found.fun) if improved else (objective.start([seed, restarts]), np.inf)


def as_the_chapter(seed: int) -> Trace:
    """115 evaluations without limits, then the motion that was found scaled until it keeps them at every instant."""
    objective = Objective(CHAPTER)
    recorder = Recorder(objective, "Nelder-Mead, as the chapter")
    start = objective.start([seed, 0])
    options: Any = {"maxfev": CHAPTER_EVALUATIONS}

    def unlimited(x: Array) -> float:
        return -float(objective.score(x[None]).logdet[0])

    found = minimize(unlimited, start, method="Nelder-Mead", options=options)
    motion = Trajectory(CHAPTER, found.x * objective.unit)
    fitting = motion.scaled(1 / LimitUse.of(motion, LIMITS).worst.use)
    recorder.evaluations += int(found.nfev)
    recorder.cost(fitting.coefficients / objective.unit)
    return recorder.trace()
