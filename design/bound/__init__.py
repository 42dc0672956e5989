"""Upper bound by duality on ln det of the information of any periodic trajectory within the limits."""

from __future__ import annotations

from design.bound.column_generation import GenerationRound
from design.bound.duality_bound import BoundKind, DualityBound
from design.bound.periodicity_conditions import PolynomialDegrees
from design.bound.upper_bound import Effort, upper_bound
from design.bound.viable_states import ViableStates
from design.bound.weak_duality import WeakDuality

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
