"""Constraints on parameters: bounds, physical consistency and a prior; their feasible region."""
