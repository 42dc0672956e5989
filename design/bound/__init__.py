"""Upper bound by duality on ln det of the information of any periodic trajectory within the limits."""

from __future__ import annotations

from design.bound.branch_and_bound import WeakDuality
from design.bound.column_generation import GenerationRound
from design.bound.dual_function import PolynomialDegrees, ViableStates
from design.bound.upper_bound import BoundKind, DualityBound, Effort, upper_bound

__all__ = [
    "BoundKind",
    "DualityBound",
    "Effort",
    "GenerationRound",
    "PolynomialDegrees",
    "ViableStates",
    "WeakDuality",
    "upper_bound",
]
