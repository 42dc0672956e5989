"""Optimal design of exciting trajectories within limits: criteria, optimiser and upper bound by duality."""
