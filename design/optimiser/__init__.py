"""Optimiser: multistart local optimisation of a trajectory within its limits, by interior-point methods."""
