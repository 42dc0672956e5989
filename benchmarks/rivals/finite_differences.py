"""L-BFGS-B (Byrd, Lu, Nocedal, Zhu, SIAM J. Sci. Comput. 16 (1995) 1190-1208) by SciPy, with forward differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from benchmarks.rivals.objective import Objective
from benchmarks.rivals.reference import FREE
from benchmarks.rivals.trace import Recorder, Trace

Array = npt.NDArray[np.float64]

EVALUATIONS = 90_000
"""As many as three runs of the simplex: each difference is one."""
STARTS = 3
STEP = 1.5e-8
"""Of a difference, in shares of a limit: the root of the machine's precision, as SciPy takes it."""
BLOCK = 12
"""Candidates that are evaluated together: their arrays stay in the processor's cache, which halves the time of 34."""
CORRECTIONS = 20
"""Pairs of steps that the Hessian is made of: with the default of 10 it ends lower."""


def penalised(seed: int, evaluations: int = EVALUATIONS) -> Trace:
    """A free series with the penalty from several starts, an equal share of the evaluations at the most for each.

    All differences of a gradient are evaluated together, which SciPy's own `jac="2-point"` would do one by one. Starts
    go on until all evaluations are used.
    """
    objective = Objective(FREE)
    recorder = Recorder(objective, "L-BFGS-B, differences, penalty")
    calls, attempt = FREE.size + 1, 0

    def both(x: Array) -> tuple[float, Array]:
        candidates = np.vstack([x, x + STEP * np.eye(len(x))])
        costs = np.concatenate([recorder.costs(candidates[i : i + BLOCK]) for i in range(0, calls, BLOCK)])
        return float(costs[0]), (costs[1:] - costs[0]) / STEP

    while (left := (evaluations - recorder.evaluations) // calls) > 0:
        options: Any = {"maxfun": min(left, evaluations // STARTS // calls), "maxiter": left, "maxcor": CORRECTIONS}
        minimize(both, objective.start([seed, attempt]), jac=True, method="L-BFGS-B", options=options)
        attempt += 1
    return recorder.trace()
