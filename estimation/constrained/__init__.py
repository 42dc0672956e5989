"""Fits under constraints: bounds, physical consistency and a prior; which of them are active, and what that says."""

from __future__ import annotations

from estimation.constrained.active import Active, Pressure
from estimation.constrained.bounds import Bounds
from estimation.constrained.constraints import Constraints
from estimation.constrained.minimum import ConstrainedMinimum, minimise
from estimation.constrained.prior import Prior

__all__ = ["Active", "Bounds", "ConstrainedMinimum", "Constraints", "Pressure", "Prior", "minimise"]
