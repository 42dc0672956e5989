"""Nonlinear program solved by IPOPT, and its termination status."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.optimiser.limit_constraints import LimitConstraints
from design.optimiser.objective import Objective

Array = NDArray[np.float64]

OPTIMALITY_TOLERANCE = 1e-6
"""Of the optimality conditions, in nats: negligible in numbers of measurements."""
ACCEPTABLE_TOLERANCE = 1e-4
"""Tolerance that is accepted when there is no improvement for some iterations."""
_SOLVER_LOCK = threading.Lock()
"""IPOPT's linear solver (MUMPS) has process-wide state: threads take turns."""


class TerminationStatus(Enum):
    """Termination status of an optimisation; the value describes it and its remedy."""

    CONVERGED = "converged: the conditions of a local optimum hold"
    CONTRACTED = "ended outside its limits and was contracted into them: try other starts, or more harmonics"
    ITERATIONS = "stopped at the most iterations allowed: allow more, or start nearer"
    INFEASIBLE = "found no trajectory within the limits: widen them, or give a series with more coefficients"
    FAILED = "the interior-point method failed: try other starts"
    INTERRUPTED = "interrupted: the best so far, which a whole search may exceed"


_STATUS = {
    "Solve_Succeeded": TerminationStatus.CONVERGED,
    "Solved_To_Acceptable_Level": TerminationStatus.CONVERGED,
    "Maximum_Iterations_Exceeded": TerminationStatus.ITERATIONS,
    "Infeasible_Problem_Detected": TerminationStatus.INFEASIBLE,
    "Restoration_Failed": TerminationStatus.INFEASIBLE,
}


@dataclass(frozen=True, eq=False)
class OptimiserSolution:
    """Coefficients (k,), termination status and number of evaluations of the criterion."""

    coefficients: Array
    outcome: TerminationStatus
    evaluations: int


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
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

    def solve(self, *, iterations: int, warm: bool) -> OptimiserSolution:
        """By IPOPT; `warm`: the start is nearly the solution, and the barrier parameter starts small."""
        import casadi as ca

        program = {"x": self.x, "f": self.f, "g": self.g}
        solver = ca.nlpsol("design", "ipopt", program, self._options(iterations, warm))
        with _SOLVER_LOCK:
            found = solver(x0=self.start, lbg=self.low, ubg=self.high)
        stats: Mapping[str, Any] = solver.stats()
        return OptimiserSolution(
            coefficients=np.array(found["x"]).ravel(),
            outcome=_STATUS.get(stats["return_status"], TerminationStatus.FAILED),
            evaluations=int(stats["n_call_nlp_f"]),
        )

    def _options(self, iterations: int, warm: bool) -> dict[str, Any]:
        options: dict[str, Any] = {"print_time": False, "show_eval_warnings": False, "ipopt.print_level": 0}
        options |= {"ipopt.sb": "yes", "ipopt.tol": OPTIMALITY_TOLERANCE, "ipopt.acceptable_tol": ACCEPTABLE_TOLERANCE}
        options |= {"ipopt.max_iter": iterations}
        if warm:
            options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
        if self.hessian is None:
            return options | {"ipopt.hessian_approximation": "limited-memory"}
        return options | {"hess_lag": self.hessian}


def limit_constrained_program(objective: Objective, rows: LimitConstraints, start: Array) -> NonlinearProgram:
    """Maximise the objective within the constraints, from coefficients (k,) that need not be feasible."""
    import casadi as ca

    z = ca.MX.sym("z", objective.series.size)
    limits, low, high = rows.graph(z)
    hessian = None
    if objective.exact:
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", limits.numel())
        whole = ca.triu(rows.curvature(z, multipliers) - factor * objective.hessian(z))
        hessian = ca.Function("nlp_hess_l", [z, ca.MX.sym("none", 0), factor, multipliers], [whole])
    return NonlinearProgram(z, -objective.graph(z), limits, low, high, start, hessian)
