"""Solver: CVXPY with Clarabel, tight, and what counts as solved."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

SOLVER_TOLERANCE = 1e-10
"""Gap and infeasibility at which Clarabel stops, of a program of unit size: what is left, the polishing removes."""


def cvxpy() -> Any:
    """CVXPY, imported when a program is built: it takes a second. Its hints omit half of its names."""
    return import_module("cvxpy")


def solved(program: Any) -> bool:
    """Solve a CVXPY problem; False when no solution was found."""
    cp = cvxpy()
    tight = {f"tol_{name}": SOLVER_TOLERANCE for name in ("gap_abs", "gap_rel", "feas")}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccurate solutions: the status says it, and optimality is checked
            program.solve(solver=cp.CLARABEL, **tight)
    except cp.error.SolverError:
        return False
    return program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
