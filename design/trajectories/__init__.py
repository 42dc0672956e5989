"""Parametrised joint trajectories, linear in their coefficients, and guaranteed bounds between samples."""
