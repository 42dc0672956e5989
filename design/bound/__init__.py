"""The bound: how good any motion within the limits can be."""

from __future__ import annotations

from design.bound.along import AlongMotion
from design.bound.bound import Bound, Kind
from design.bound.conditions import Degrees
from design.bound.generation import Round
from design.bound.upper_bound import Effort, upper_bound
from design.bound.viability import ViableStates

__all__ = ["AlongMotion", "Bound", "Degrees", "Effort", "Kind", "Round", "ViableStates", "upper_bound"]
