"""Symbolic derivations: intermediate variables, straight-line programs, and their conversion to NumPy and CasADi."""
