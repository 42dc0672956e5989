"""Constrained least squares: bounds, physical consistency and a prior; active set and Lagrange multiplier tests."""

from __future__ import annotations

from estimation.least_squares.constrained.active_constraint import ActiveConstraint, ConstraintInterpretation
from estimation.least_squares.constrained.constrained_minimum import ConstrainedMinimum, minimise_constrained
from estimation.least_squares.constraints.bounds import Bounds
from estimation.least_squares.constraints.constraints import Constraints
from estimation.least_squares.constraints.prior import Prior

__all__ = [
    "ActiveConstraint",
    "Bounds",
    "ConstrainedMinimum",
    "ConstraintInterpretation",
    "Constraints",
    "Prior",
    "minimise_constrained",
]
