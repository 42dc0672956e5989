"""Program: one nonlinear program of the coefficients, and what the interior point made of it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.optimiser.objective import Objective
from design.optimiser.rows import Rows

Array = NDArray[np.float64]

ACCURACY = 1e-6
"""Of the optimality conditions, in nats: far below what a nat is worth in measurements."""
ENOUGH = 1e-4
"""Accuracy that is taken when it gets no better for some iterations."""
_ONE_AT_A_TIME = threading.Lock()
"""The linear solver of the interior point (MUMPS) keeps a state of the whole process: threads take turns."""


class Outcome(Enum):
    """How an optimisation ended; the value says it, and what to do about it."""

    CONVERGED = "converged: the conditions of a local optimum hold"
    CONTRACTED = "ended outside its limits and was contracted into them: try other starts, or more harmonics"
    ITERATIONS = "stopped at the most iterations allowed: allow more, or start nearer"
    INFEASIBLE = "found no motion within the limits: widen them, or give a series with more freedom"
    FAILED = "the interior point gave up: try other starts"


_STATUS = {
    "Solve_Succeeded": Outcome.CONVERGED,
    "Solved_To_Acceptable_Level": Outcome.CONVERGED,
    "Maximum_Iterations_Exceeded": Outcome.ITERATIONS,
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "Restoration_Failed": Outcome.INFEASIBLE,
}


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients (k,), how it ended and how often the criterion was asked."""

    coefficients: Array
    outcome: Outcome
    evaluations: int


@dataclass(frozen=True, eq=False)
class Program:
    """minimise f(x) within low <= g(x) <= high, from x = start.

    `hessian` is the upper triangle of f's second derivative times `factor` and of g's in the multipliers, or None.
    """

    x: Any
    f: Any
    g: Any
    low: Array
    high: Array
    start: Array
    hessian: Any = None

    def solve(self, *, iterations: int, warm: bool) -> Solution:
        """By IPOPT; `warm` says that the start is nearly the solution: the barrier then starts low."""
        import casadi as ca

        program = {"x": self.x, "f": self.f, "g": self.g}
        solver = ca.nlpsol("design", "ipopt", program, self._options(iterations, warm))
        with _ONE_AT_A_TIME:
            found = solver(x0=self.start, lbg=self.low, ubg=self.high)
        stats: Mapping[str, Any] = solver.stats()
        return Solution(
            coefficients=np.array(found["x"]).ravel(),
            outcome=_STATUS.get(stats["return_status"], Outcome.FAILED),
            evaluations=int(stats["n_call_nlp_f"]),
        )

    def _options(self, iterations: int, warm: bool) -> dict[str, Any]:
        options: dict[str, Any] = {"print_time": False, "show_eval_warnings": False, "ipopt.print_level": 0}
        options |= {"ipopt.sb": "yes", "ipopt.tol": ACCURACY, "ipopt.acceptable_tol": ENOUGH}
        options |= {"ipopt.max_iter": iterations}
        if warm:
            options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
        if self.hessian is None:
            return options | {"ipopt.hessian_approximation": "limited-memory"}
        return options | {"hess_lag": self.hessian}


def program(objective: Objective, rows: Rows, start: Array) -> Program:
    """Maximise the objective within the rows, from coefficients (k,) that need not be feasible."""
    import casadi as ca

    z = ca.MX.sym("z", objective.series.size)
    limits, low, high = rows.graph(z)
    hessian = None
    if objective.exact:
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", limits.numel())
        whole = ca.triu(rows.curvature(z, multipliers) - factor * objective.hessian(z))
        hessian = ca.Function("nlp_hess_l", [z, ca.MX.sym("none", 0), factor, multipliers], [whole])
    return Program(z, -objective.graph(z), limits, low, high, start, hessian)
