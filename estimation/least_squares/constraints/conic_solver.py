"""Conic programs solved by CVXPY and Clarabel at tight tolerance."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

SOLVER_TOLERANCE = 1e-10
"""Gap and infeasibility at which Clarabel stops, of a program of unit size; Newton steps refine the result."""


def cvxpy() -> Any:
    """CVXPY, imported only when a program is built: the import takes a second. Its type hints are incomplete."""
    return import_module("cvxpy")


def solve_conic(program: Any) -> bool:
    """Solve a CVXPY problem; False when no solution was found."""
    cp = cvxpy()
    tight = {f"tol_{name}": SOLVER_TOLERANCE for name in ("gap_abs", "gap_rel", "feas")}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # inaccurate solutions: the status tells, and optimality is checked
            program.solve(solver=cp.CLARABEL, **tight)
    except cp.error.SolverError:
        return False
    return program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
